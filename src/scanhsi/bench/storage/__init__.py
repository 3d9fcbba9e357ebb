"""What storing and reading cubes costs: ours, the libraries that others use, and what the disk itself can do."""
