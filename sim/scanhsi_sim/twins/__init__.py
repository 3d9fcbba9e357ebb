"""Twins: processes that speak the wire protocols of real devices, so that the real drivers run against them."""
