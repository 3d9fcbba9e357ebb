from pathlib import Path

import numpy as np
import pytest

from scanhsi.calibration.lines import hgar, line_list, load_lines
from scanhsi.devices.errors import CalibrationError


def test_the_lines_of_the_lamp_are_those_in_air():
    lines = hgar()
    assert (np.diff(lines.wavelength_nm) > 0).all()
    for known in (404.6565, 435.8335, 546.0750, 576.9610, 579.0670, 763.5106, 912.2967):  # 579.067 is missing elsewhere
        assert known in lines.wavelength_nm
    green = float(lines.wavelength_nm[np.searchsorted(lines.wavelength_nm, 546.0)])
    assert green == 546.0750  # 546.2268 in vacuum
    assert set(lines.species) == {"Hg I", "Ar I"}
    assert len(lines.calibrating()) == len(lines) - 6
    assert lines.within(371, 948).wavelength_nm[-1] == 935.4220


def test_what_cannot_be_told_apart_is_one_line_at_the_mean_by_intensity():
    merged = hgar().merged(1.8)
    double = merged.within(772, 773)
    assert double.wavelength_nm.tolist() == pytest.approx([(772.3761 * 15 + 772.4207 * 10) / 25])
    assert double.intensity.tolist() == [25_000]
    assert len(merged.within(576, 580)) == 2


def test_a_certificate_of_ones_own(tmp_path: Path):
    table = tmp_path / "tile.csv"
    table.write_text("\ufeff# certificate 4711\n\nwavelength_nm, depth\n799.1,0.3\n536.5 , 0.2\n", encoding="utf-8")
    lines = load_lines(table)
    assert lines.wavelength_nm.tolist() == [536.5, 799.1]
    assert lines.fit.all()
    assert lines.name == str(table)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "no column wavelength_nm"),
        ("nm\n500\n", "no column wavelength_nm"),
        ("wavelength_nm\n", "holds no line"),
        ("wavelength_nm\nabc\n", "row 1: could not convert"),
        ("wavelength_nm\n0.5461\n", "no wavelength in nm"),
        ("wavelength_nm\nnan\n", "no wavelength in nm"),
        ("wavelength_nm,intensity\n500,-1\n", "intensity -1"),
        ("wavelength_nm,use\n500,maybe\n", "use is 'maybe'"),
        ("wavelength_nm\n500\n500.0\n", "twice"),
    ],
)
def test_a_table_that_is_not_understood_is_refused(tmp_path: Path, text: str, why: str):
    path = tmp_path / "lines.csv"
    path.write_text(text)
    with pytest.raises(CalibrationError, match=why):
        load_lines(path)


def test_a_file_that_is_not_there(tmp_path: Path):
    with pytest.raises(CalibrationError, match="cannot read"):
        load_lines(tmp_path / "none.csv")
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00\xd8")
    with pytest.raises(CalibrationError, match="no text file"):
        load_lines(tmp_path / "binary.csv")


def test_bare_wavelengths_are_sorted():
    assert line_list("mine", [600, 500]).wavelength_nm.tolist() == [500, 600]
