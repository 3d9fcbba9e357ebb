"""The instrument: what a person configures, and the open devices it composes."""
