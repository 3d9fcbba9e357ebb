"""Cubes on disk: what is known of each line, where lines go, the streaming writer, the reader."""

from scanhsi.cube.binning import Binning
from scanhsi.cube.layout import CubeSpec
from scanhsi.cube.quicklook import QuicklookSpec
from scanhsi.cube.reader import open_cube
from scanhsi.cube.records import LineRecords, LineStatus
from scanhsi.cube.sink import DiscardSink, LineSink
from scanhsi.cube.writer import CubeWriter

__all__ = [
    "Binning",
    "CubeSpec",
    "CubeWriter",
    "DiscardSink",
    "LineRecords",
    "LineSink",
    "LineStatus",
    "QuicklookSpec",
    "open_cube",
]
