"""Options that say what becomes of raw counts: of ``scanhsi process``, and of ``scanhsi scan`` as it scans."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from scanhsi.calibration.applies import Limits
    from scanhsi.calibration.reference import ModelledDark, Reference
    from scanhsi.processing import Step

_USUAL_TILE = 0.99

DarkOption = Annotated[
    Path | None, typer.Option(help="Dark reference: a cube at the exposure of the raw one, or a dark model (*.nc).")
]
WhiteOption = Annotated[
    Path | None, typer.Option(help="White reference: a cube of the tile, or of `scanhsi calibrate white`.")
]
WhiteDarkOption = Annotated[
    Path | None, typer.Option(help="Dark reference at the exposure of the white one.", show_default="--dark")
]
TileOption = Annotated[
    float | None,
    typer.Option(help="Reflectance of the white tile.", show_default="as the white reference says, or 0.99"),
]
SaturationOption = Annotated[
    float | None,
    typer.Option(help="Counts from which a pixel is saturated.", show_default="a plateau that is found, or full scale"),
]
WavelengthOption = Annotated[
    Path | None, typer.Option(help="Wavelength calibration, of `scanhsi calibrate wavelength`.")
]
MaxAgeOption = Annotated[
    str | None,
    typer.Option(
        metavar="TIME",
        help='Oldest good calibration, as "12 h", or any; default: by its kind, a day for a white reference, 30 for a dark model.',
    ),
]
MaxDriftOption = Annotated[float, typer.Option(help="How far sensor temperatures may be apart, K.")]
SmileOption = Annotated[Path | None, typer.Option(help="Smile calibration: straighten the smile.")]
KeystoneOption = Annotated[Path | None, typer.Option(help="Keystone calibration: straighten the keystone.")]


@dataclass(frozen=True, slots=True)
class Chain:
    """What was asked for."""

    dark: Path | None = None
    white: Path | None = None
    white_dark: Path | None = None
    tile: float | None = None
    saturation: float | None = None
    wavelength: Path | None = None
    smile: Path | None = None
    keystone: Path | None = None
    bin_bands: int | None = None

    def steps(self) -> list[Step]:
        """The steps, in order.

        Raises:
            typer.BadParameter: They make no chain.
            NotACube, CubeError, CalibrationError: A reference cannot be read, or is none.
        """
        from scanhsi.processing import BinBands, MaskSaturated

        if self.white is not None and self.dark is None:
            raise typer.BadParameter("reflectance needs a dark reference too.", param_hint="--dark")
        steps: list[Step] = [MaskSaturated(self.saturation), *self._references(), *self._spectral()]
        if self.bin_bands is not None:
            steps.append(BinBands(self.bin_bands))
        if len(steps) == 1:
            raise typer.BadParameter("nothing to do: give --dark, --dark with --white, or --bin-bands.")
        return steps

    def check(self, cube: Mapping[str, Any], limits: Limits) -> None:
        """Refuse calibrations that are not for a cube.

        Args:
            cube: Its attributes.
            limits: Of age and temperature.

        Raises:
            CalibrationError: Gain, format, region, binning, age or temperature of one do not fit; says which, and what to do.
        """
        from scanhsi.calibration.applies import check_files

        check_files([self.dark, self.white, self.white_dark, self.wavelength, self.smile, self.keystone], cube, limits)

    def _references(self) -> list[Step]:
        from scanhsi.processing import SubtractDark

        if self.dark is None:
            return []
        dark = _dark(self.dark)
        if self.white is None:
            return [SubtractDark(dark)]
        below = dark if self.white_dark in (None, self.dark) else _dark(self.white_dark)
        return [SubtractDark(dark), _reflectance(self.white, below, self.tile)]

    def _spectral(self) -> list[Step]:
        from scanhsi.calibration.keystone import Keystone
        from scanhsi.calibration.result import load
        from scanhsi.calibration.smile import Smile
        from scanhsi.calibration.wavelength import Wavelength
        from scanhsi.processing import AssignWavelength, CorrectKeystone, CorrectSmile

        steps: list[Step] = []
        if self.wavelength is not None:
            steps.append(AssignWavelength(load(Wavelength, self.wavelength)))
        if self.smile is not None:
            steps.append(CorrectSmile(load(Smile, self.smile)))
        if self.keystone is not None:
            steps.append(CorrectKeystone(load(Keystone, self.keystone)))
        return steps


def _dark(path: Path | None) -> Reference | ModelledDark:
    """A dark cube's mean, or a dark model."""
    from scanhsi.calibration.dark import DarkModel
    from scanhsi.calibration.kinds import is_result
    from scanhsi.calibration.reference import ModelledDark, average
    from scanhsi.calibration.result import load

    assert path is not None, "asked for"
    return ModelledDark(str(path), load(DarkModel, path)) if is_result(path) else average(path)


def _reflectance(path: Path, dark: Reference | ModelledDark, tile: float | None) -> Step:
    """By the mean of a tile's cube; or by a white reference, which brings its own dark signal and tile."""
    from scanhsi.calibration.kinds import is_result
    from scanhsi.calibration.reference import average
    from scanhsi.calibration.result import load
    from scanhsi.calibration.white import WhiteReference
    from scanhsi.processing import Reflectance

    if not is_result(path):
        return Reflectance(average(path), dark, _USUAL_TILE if tile is None else tile)
    result = load(WhiteReference, path)
    return Reflectance(*result.references(str(path)), result.tile if tile is None else tile)
