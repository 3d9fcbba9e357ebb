"""Cubes on disk: what is known of each line, where lines go, the streaming writer, the reader."""
