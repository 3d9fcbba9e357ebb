"""``python -m scanhsi``: the same as ``scanhsi``."""

from scanhsi.cli import main

main()
