"""Smile: how the wavelength of a band changes along the slit (figure 9), and the wavelength of every pixel.

The image of a straight slit is curved. Lines of a lamp are followed along it, block by block, and a quadratic goes through each;
how it bends may change with the band. All lines share one fit, which also gives each its place in the middle of the slit, from all
samples.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Any, ClassVar, Final, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scanhsi.calibration.assign import DispersionRange
from scanhsi.calibration.dispersion import Dispersion
from scanhsi.calibration.line_fit import GAUSSIAN, Fitted, Group, fit_group, group_lines
from scanhsi.calibration.lines import LineList, hgar
from scanhsi.calibration.peaks import find_peaks
from scanhsi.calibration.result import Provenance, Stored
from scanhsi.calibration.wavelength import PLACE_FLOOR, Wavelength, fit_lines, identify, through
from scanhsi.devices.errors import CalibrationError

Floats = NDArray[np.float64]

_ORDERS: Final = (1, 2)  # of the sample: slant and bend
_OUTLYING: Final = 5.0
_LEAST_BLOCKS: Final = 5


@dataclass(frozen=True, slots=True, eq=False)
class Smile:
    """Where light of one wavelength falls along the slit.

    With ``u`` from -1 to 1 over the bands and ``t = (sample - reference_sample) / (samples / 2)``, light that falls on a band at
    the reference sample falls ``sum of coefficients[m, k - 1] u^m t^k`` bands further at another.

    Attributes:
        bands, samples: Of the sensor region that this is for.
        reference_sample: Where the shift is 0, and the `Wavelength` holds.
        coefficients, coefficients_sigma: In bands, (band_power, sample_power), with standard errors.
        residual_bands: Standard deviation of the places around the fit.
        line_nm: Lines followed, (line,).
        block: Middle sample of each block, (block,).
        line_band: Where each line lies in each block, (line, block); nan where it does not show.
        line_fwhm_nm: Width of each line in each block, (line, block): the spectral resolution.
        provenance: Where it comes from.
    """

    kind: ClassVar[str] = "smile"

    bands: int
    samples: int
    reference_sample: float
    coefficients: Annotated[Floats, Stored("1", "shift in bands", ("band_power", "sample_power"))]
    coefficients_sigma: Annotated[Floats, Stored("1", "standard error", ("band_power", "sample_power"))]
    residual_bands: Annotated[float, Stored("1", "standard deviation around the fit, in bands")]
    line_nm: Annotated[Floats, Stored("nm", "wavelengths of the lines", ("line",))]
    block: Annotated[Floats, Stored("1", "middle sample of a block", ("block",))]
    line_band: Annotated[Floats, Stored("1", "place of a line, in bands", ("line", "block"))]
    line_fwhm_nm: Annotated[Floats, Stored("nm", "full width at half maximum", ("line", "block"))]
    provenance: Provenance

    def shift(self, band: ArrayLike | None = None, sample: ArrayLike | None = None) -> Floats:
        """Bands by which light of a band of the reference sample falls further at another; (band, sample) by default.

        Broadcasts what is given.
        """
        rows = np.arange(self.bands)[:, None] if band is None else np.asarray(band, np.float64)
        columns = np.arange(self.samples) if sample is None else np.asarray(sample, np.float64)
        terms = _terms(self._across(rows), self._along(columns))
        return cast("Floats", sum(term * value for term, value in zip(terms, self.coefficients.flat, strict=True)))

    def wavelength_map(self, wavelength: Wavelength) -> Floats:
        """Wavelength of every pixel in nm, (band, sample), uncorrected."""
        band: Floats = np.arange(self.bands, dtype=np.float64)[:, None]
        sample: Floats = np.arange(self.samples, dtype=np.float64)
        origin = band - self.shift(band, sample)
        for _ in range(2):  # the shift is that of the band where the light falls at the reference
            origin = band - self.shift(origin, sample)
        return wavelength.nm(origin)

    @property
    def largest_bands(self) -> float:
        """Largest change of place from one end of the slit to anywhere else, of any band."""
        return float(np.ptp(self.shift(), axis=1).max())

    def _across(self, band: ArrayLike) -> Floats:
        return 2 * np.asarray(band, np.float64) / max(self.bands - 1, 1) - 1

    def _along(self, sample: ArrayLike) -> Floats:
        return (np.asarray(sample, np.float64) - self.reference_sample) / (self.samples / 2)


def _terms(across: Floats, along: Floats) -> list[Floats]:
    """Terms of the shift in the order of the coefficients."""
    return [across**power * along**order for power in (0, 1) for order in _ORDERS]


@dataclass(frozen=True, slots=True, eq=False)
class Traces:
    """Lines followed along the slit: places, errors and widths in bands, (line, block) each; nan where one does not show."""

    line_nm: Floats
    block: Floats
    band: Floats
    band_sigma: Floats
    fwhm: Floats
    fwhm_sigma: Floats


def trace_lines(
    frame: NDArray[Any],
    dispersion: Dispersion,
    lines: LineList,
    fwhm: float,
    *,
    block: int = 24,
    shape: float = GAUSSIAN,
) -> Traces:
    """Follow the lines from the middle of the slit to its ends.

    Args:
        frame: (band, sample) of the lamp, dark-corrected; nan (saturated, hot) spoils only lines of its own block.
        dispersion: In the middle of the slit.
        lines: Of the lamp.
        fwhm: Width of a line in bands.
        block: Samples that are averaged.
        shape: Of a line, one of `scanhsi.calibration.line_fit.SHAPES`.

    Raises:
        CalibrationError: Too few samples, or lines.
    """
    values = np.asarray(frame, np.float64)
    bands, samples = values.shape
    parts = max(1, samples // block)
    cuts = np.arange(parts + 1) * samples // parts
    if len(cuts) <= _LEAST_BLOCKS:
        raise CalibrationError(
            f"{samples} samples are too few to follow a line along: {_LEAST_BLOCKS * block} at least."
        )
    spectra = [values[:, low:high].mean(axis=1) for low, high in pairwise(cuts.tolist())]
    groups = group_lines(lines, dispersion, bands, fwhm)
    rows = [(group, _follow(spectra, group, fwhm, shape)) for group in groups]
    shown = [(group, row) for group, row in rows if sum(one is not None for one in row) > len(row) / 2]
    if len(shown) < 2:
        raise CalibrationError("fewer than two lines can be followed along the slit.", hint="light all of the slit")
    # Which wavelength is the middle of a group depends on the heights found: one value a group, and the shift goes with any.
    middles = [float(np.median([one.wavelength_nm for one in row if one])) for _, row in shown]
    there = [float(np.interp(nm, *_rising(group))) for nm, (group, _) in zip(middles, shown, strict=True)]
    return Traces(
        line_nm=np.array(middles),
        block=np.array([(low + high - 1) / 2 for low, high in pairwise(cuts.tolist())]),
        band=np.array(there)[:, None] + _table([row for _, row in shown], "shift"),
        band_sigma=_table([row for _, row in shown], "band_sigma"),
        fwhm=_table([row for _, row in shown], "fwhm"),
        fwhm_sigma=_table([row for _, row in shown], "fwhm_sigma"),
    )


def _rising(group: Group) -> tuple[Floats, Floats]:
    order = np.argsort(group.wavelength_nm)
    return group.wavelength_nm[order], group.band[order]


def _follow(spectra: list[Floats], group: Group, fwhm: float, shape: float) -> list[Fitted | None]:
    """One group in every block, each starting where its neighbour towards the middle was found."""
    row: list[Fitted | None] = [None] * len(spectra)
    middle = len(spectra) // 2
    for order in (range(middle, len(spectra)), range(middle, -1, -1)):
        shift = 0.0
        for index in order:
            row[index] = one = fit_group(spectra[index], group, fwhm, shift=shift, shape=shape)
            shift = one.shift if one else shift
    return row


def _table(rows: list[list[Fitted | None]], name: str) -> Floats:
    return np.array([[math.nan if one is None else getattr(one, name) for one in row] for row in rows], np.float64)


def fit_smile(
    traces: Traces, bands: int, samples: int, wavelength: Dispersion, provenance: Provenance
) -> tuple[Smile, Floats, Floats]:
    """Fit the smile to lines that were followed.

    Args:
        traces: Of `trace_lines`.
        bands: Of the frame.
        samples: Of the frame.
        wavelength: Turns widths into nm.
        provenance: Where the lines come from.

    Returns:
        The smile, and where each line lies at the reference sample with its standard error, in bands, (line,); the error is nan
        of a line that does not follow the others.

    Raises:
        CalibrationError: The places cannot be fitted.
    """
    reference = (samples - 1) / 2
    line, column = np.nonzero(np.isfinite(traces.band) & (traces.band_sigma < 0.5))
    if len(line) < len(traces.line_nm) + 2 * len(_ORDERS) + 3:
        raise CalibrationError(f"{len(line)} places of lines along the slit are too few for its smile.")
    place = traces.band[line, column]
    sigma = np.hypot(traces.band_sigma[line, column], PLACE_FLOOR)
    middle = np.nanmedian(traces.band, axis=1)
    terms = _terms(2 * middle[line] / max(bands - 1, 1) - 1, (traces.block[column] - reference) / (samples / 2))
    own = (line[:, None] == np.arange(len(middle))).astype(np.float64)
    design = np.hstack((own, np.stack(terms, axis=1)))
    good = np.ones(len(place), bool)
    best, left = np.zeros(design.shape[1]), place
    for _ in range(5):
        best = cast(
            "Floats", np.linalg.lstsq(design[good] / sigma[good, None], place[good] / sigma[good], rcond=1e-10)[0]
        )
        left = place - design @ best
        limit = _OUTLYING * np.maximum(sigma, 1.4826 * np.median(np.abs(left[good])))
        again = np.abs(left) <= limit
        if (again == good).all():
            break
        good = again
    freedom = int(good.sum()) - len(best)
    if freedom < 1:
        raise CalibrationError("the lines do not share a smile.", hint="is the slit lit evenly, and all of it?")
    weighted = design[good] / sigma[good, None]
    scatter = max(1.0, float(np.sum((left[good] / sigma[good]) ** 2)) / freedom)
    spread = np.sqrt(np.maximum(np.diag(np.linalg.pinv(weighted.T @ weighted)), 0) * scatter)
    lines = len(middle)
    used, shown = np.bincount(line[good], minlength=lines), np.bincount(line, minlength=lines)
    spread[:lines][used < 0.5 * shown] = np.nan  # it bends otherwise than the rest: another line lies below it
    smile = Smile(
        bands=bands,
        samples=samples,
        reference_sample=reference,
        coefficients=best[lines:].reshape(2, -1),
        coefficients_sigma=spread[lines:].reshape(2, -1),
        residual_bands=math.sqrt(float(np.sum(left[good] ** 2)) / freedom),
        line_nm=traces.line_nm,
        block=traces.block,
        line_band=traces.band,
        line_fwhm_nm=traces.fwhm * np.abs(wavelength.nm_per_band(traces.band)),
        provenance=provenance,
    )
    return smile, best[:lines], spread[:lines]


def calibrate_spectrograph(
    frame: NDArray[Any],
    provenance: Provenance,
    *,
    lines: LineList | None = None,
    prior: DispersionRange | None = None,
    degree: int = 2,
    fwhm_bands: float = 5.5,
) -> tuple[Wavelength, Smile]:
    """Wavelength and smile from one frame of a lamp that lights all of the slit.

    The lines are identified in the middle of the slit, followed to its ends, and the polynomial goes through their places at the
    middle that the fit of all samples gives.

    Args:
        frame: (band, sample), mean of some lines, dark-corrected.
        provenance: Where it comes from.
        lines: Of the lamp; mercury-argon by default.
        prior: What the dispersion may be.
        degree: Of the polynomial.
        fwhm_bands: Roughly the width of a line in bands.

    Raises:
        CalibrationError: Saturated or noisy, the slit is not lit, or the lines are not these.
    """
    values = np.asarray(frame, np.float64)
    if values.ndim != 2:
        raise CalibrationError(f"a frame has bands and samples, not {values.shape}.")
    bands, samples = values.shape
    lines = lines or hgar()
    tenth = max(1, samples // 20)
    spectrum = values[:, samples // 2 - tenth : samples // 2 + tenth].mean(axis=1)
    peaks = find_peaks(spectrum, fwhm_px=fwhm_bands)
    fwhm = float(np.median(peaks.fwhm_px))
    first = identify(peaks.centre_px, fwhm, lines, prior, degree)
    fitted, shape = fit_lines(spectrum, first, lines, fwhm, degree)
    rough = through(fitted, bands, len(peaks), lines.name, degree, provenance)
    traces = trace_lines(values, rough.dispersion, lines, fwhm, shape=shape)
    smile, place, sigma = fit_smile(traces, bands, samples, rough.dispersion, provenance)
    fitted = [
        Fitted(
            band=float(place[index]),
            band_sigma=float(sigma[index]),
            wavelength_nm=float(nm),
            fwhm=float(np.nanmedian(traces.fwhm[index])),
            fwhm_sigma=float(np.nanmedian(traces.fwhm_sigma[index]) / math.sqrt(np.isfinite(traces.fwhm[index]).sum())),
            shift=0.0,
        )
        for index, nm in enumerate(traces.line_nm)
        if np.isfinite(sigma[index])
    ]
    return through(fitted, bands, len(peaks), lines.name, degree, provenance), smile
