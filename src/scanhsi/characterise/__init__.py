"""Protocols that take what a calibration needs, with an instrument or from cubes; aids to set one up; the specification sheet."""
