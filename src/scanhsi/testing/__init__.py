"""For authors of drivers: the contracts as a test suite. See `scanhsi.testing.conformance`."""
