"""The REST interface: one small file a group."""
