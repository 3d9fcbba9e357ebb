"""A remote instrument, operated as a local one; needs the extra ``web``."""
