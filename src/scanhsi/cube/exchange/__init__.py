"""Cubes to and from the files of other programs. No pickle in either direction: loading one runs whatever code is in it."""

from scanhsi.cube.exchange.exporting import Exported, Format, export_cube
from scanhsi.cube.exchange.importing import Imported, import_cube

__all__ = ["Exported", "Format", "Imported", "export_cube", "import_cube"]
