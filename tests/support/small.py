"""Settings of the paper's instrument for scans that are small and quick, and show where the mirror stood."""

SMALL = {
    "roi.samples": 24,
    "roi.bands": 16,
    "roi.sample_offset": 1000,
    "roi.band_offset": 500,
    "camera.scene": "testpattern",
}
