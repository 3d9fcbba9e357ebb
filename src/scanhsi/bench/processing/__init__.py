"""What processing costs: the whole chain on lines in memory, from disk to disk, and beside a scan."""
