"""From raw counts to reflectance: named steps over whole lines, run over cubes of any size or on lines as they arrive."""

from scanhsi.processing.follow import Followed, follow
from scanhsi.processing.live import LiveProcessing
from scanhsi.processing.pipeline import Pipeline
from scanhsi.processing.rectify import Grid, rectified, rectify
from scanhsi.processing.run import process
from scanhsi.processing.signal import Signal
from scanhsi.processing.spectral import AssignWavelength, CorrectKeystone, CorrectSmile
from scanhsi.processing.steps import BinBands, MaskSaturated, Reflectance, Step, SubtractDark

__all__ = [
    "AssignWavelength",
    "BinBands",
    "CorrectKeystone",
    "CorrectSmile",
    "Followed",
    "Grid",
    "LiveProcessing",
    "MaskSaturated",
    "Pipeline",
    "Reflectance",
    "Signal",
    "Step",
    "SubtractDark",
    "follow",
    "process",
    "rectified",
    "rectify",
]
