"""Force amplitude and sweep of a measurement."""

import numpy as np
import pytest

import updyn
from updyn.errors import DataError, FormatError
from updyn.frf import FRF

FREQ = np.array([5.0, 6.0, 8.0])


def measure(level=None, sweep=None, quantity="accelerance") -> FRF:
    values = np.arange(3.0)[:, None, None] + 1j
    return FRF(FREQ, values, ["2:X"], ["1:X"], quantity, level=level, sweep=sweep)


def test_one_level_is_that_of_all_lines() -> None:
    assert measure(5.0).level.tolist() == [5.0, 5.0, 5.0]
    assert measure().level is None
    assert measure().sweep is None


def test_lines_keep_their_level() -> None:
    frf = measure([1.0, 2.0, 3.0], "down")
    part = frf.select(lines=[5.0, 8.0])
    assert part.level.tolist() == [1.0, 3.0]
    assert part.sweep == "down"
    assert frf.converted("receptance").level.tolist() == [1.0, 2.0, 3.0]


def test_a_level_is_read_only_and_a_copy() -> None:
    given = np.array([1.0, 2.0, 3.0])
    frf = measure(given)
    given[:] = 7.0
    assert frf.level.tolist() == [1.0, 2.0, 3.0]
    with pytest.raises(ValueError, match="read-only"):
        frf.level[0] = 1.0


@pytest.mark.parametrize(
    ("level", "sweep", "text"),
    [
        (0.0, None, "level at 5 Hz is 0; expected a force amplitude above 0"),
        ([1.0, -2.0, 3.0], None, "level at 6 Hz is -2"),
        ([1.0, 2.0], None, r"one for each of 3 lines, found shape \(2,\)"),
        (np.nan, None, "level at 5 Hz is nan"),
        ("high", None, "level: expected real numbers"),
        (5.0, "upward", "sweep 'upward': .*'up'"),
        (None, "up", "sweep: given without a level"),
    ],
)
def test_levels_are_checked(level, sweep, text) -> None:
    with pytest.raises(DataError, match=text):
        measure(level, sweep)


def test_a_transmissibility_has_no_level() -> None:
    with pytest.raises(DataError, match="level: the amplitude of a force, but"):
        measure(5.0, quantity="transmissibility")


def test_the_level_is_part_of_the_description() -> None:
    assert "level 5 N" in repr(measure(5.0))
    assert "level 1 to 3 N down" in measure([1.0, 2.0, 3.0], "down")._repr_html_()


@pytest.mark.parametrize("suffix", ["nc", "npz", "mat", "h5", "csv"])
@pytest.mark.parametrize(
    ("level", "sweep"), [(5.0, None), ([1.0, 0.1, 1 / 3], "down"), (None, None)]
)
def test_files_keep_the_level(tmp_path, suffix, level, sweep) -> None:
    frf = measure(level, sweep)
    path = tmp_path / f"test.{suffix}"
    updyn.write_frf(frf, path)
    read = updyn.read_frf(path)
    assert read.sweep == sweep
    if level is None:
        assert read.level is None
    else:
        assert np.array_equal(read.level, frf.level)


@pytest.mark.parametrize("suffix", ["nc", "npz", "mat", "h5", "csv"])
def test_files_keep_the_kind_of_force(tmp_path, suffix) -> None:
    path = tmp_path / f"test.{suffix}"
    updyn.write_frf(measure().with_level(5.0, excitation="random"), path)
    read = updyn.read_frf(path)
    assert (read.excitation, read.is_random, read.level[0]) == ("random", True, 5.0)


@pytest.mark.parametrize(
    ("level", "sweep", "excitation", "text"),
    [
        (5.0, None, "noise", "excitation 'noise': .*'sine'"),
        (None, None, "random", "excitation: given without a level"),
        (5.0, "up", "random", "sweep: of a sine"),
    ],
)
def test_kinds_of_force_are_checked(level, sweep, excitation, text) -> None:
    with pytest.raises(DataError, match=text):
        measure().with_level(level, sweep, excitation)


def test_a_random_repeat_of_a_sine_is_refused() -> None:
    with pytest.raises(DataError, match="5 N random, the first the level 5 N"):
        updyn.average([measure(5.0), measure().with_level(5.0, excitation="random")])


def test_universal_files_lose_the_level_with_a_warning(tmp_path) -> None:
    with pytest.warns(updyn.UpdynWarning, match="cannot hold level and sweep"):
        updyn.write_frf(measure(5.0, "up"), tmp_path / "test.uff")


def test_a_level_in_a_table_is_checked(tmp_path) -> None:
    path = tmp_path / "test.csv"
    updyn.write_frf(measure(5.0), path)
    path.write_text(path.read_text().replace("# level: 5.0", "# level: high"))
    with pytest.raises(FormatError, match=r"level: 'high'; expected a number in N"):
        updyn.read_frf(path)


def test_a_response_at_a_level_states_it(chain12) -> None:
    model = chain12.with_elements({"stop": (updyn.CubicSpring(1e9), "12:X")})
    found = updyn.response(model, [1.0, 1.5], ["12:X"], ["12:X"], level=5.0, sweep="down")
    assert found.frf.level.tolist() == [5.0, 5.0]
    assert found.frf.sweep == "down"


def test_repeats_have_one_level() -> None:
    other = FRF(FREQ, measure().values * 1.01, ["2:X"], ["1:X"], "accelerance", level=2.0)
    with pytest.raises(DataError, match="repeat 2 has the level 2 N, the first the level 5 N"):
        updyn.average([measure(5.0), other])


SPECTRUM = [[4.0, 0.5], [6.5, 0.1], [9.0, 0.5]]


def test_a_random_force_has_the_spectrum_of_its_rms() -> None:
    """By default, it is constant from the first line to the last."""
    frf = measure().with_level(6.0, excitation="random")
    assert frf.spectrum.tolist() == [[5.0, 12.0], [8.0, 12.0]]
    assert measure(5.0).spectrum is None
    shaped = measure().with_level(None, excitation="random", spectrum=SPECTRUM)
    assert shaped.level.tolist() == pytest.approx([np.sqrt(1.5)] * 3)


def test_lines_keep_the_spectrum() -> None:
    frf = measure().with_level(6.0, excitation="random").band(5.0, 6.0)
    assert frf.spectrum.tolist() == [[5.0, 12.0], [8.0, 12.0]]
    assert frf.select(lines=[6.0]).spectrum.tolist() == [[5.0, 12.0], [8.0, 12.0]]
    with pytest.raises(ValueError, match="read-only"):
        frf.spectrum[0] = 1.0


@pytest.mark.parametrize("suffix", ["nc", "npz", "mat", "h5", "csv"])
def test_files_keep_the_spectrum(tmp_path, suffix) -> None:
    frf = measure().with_level(None, excitation="random", spectrum=SPECTRUM)
    path = tmp_path / f"test.{suffix}"
    updyn.write_frf(frf, path)
    assert updyn.read_frf(path).spectrum.tolist() == SPECTRUM


@pytest.mark.parametrize(
    ("level", "excitation", "spectrum", "text"),
    [
        (None, "random", [[4.0, 0.5]], r"found shape \(1, 2\)"),
        (None, "random", [[4.0, 0.5], [4.0, 0.5]], "frequencies in Hz that increase"),
        (None, "random", [[4.0, 0.5], [5.0, np.nan]], "expected finite"),
        (None, "random", [[4.0, 0.5], [5.0, -1.0]], "spectrum at 5 Hz is -1"),
        (None, "random", [[4.0, 0.0], [5.0, 0.0]], "one above 0"),
        (None, "random", "flat", "not an array of numbers"),
        (2.0, "random", SPECTRUM, "its spectrum has the RMS 1.22"),
        ([1.0, 2.0, 3.0], "random", None, "level .* of a random force"),
        (2.0, "sine", SPECTRUM, "spectrum: only of a random force"),
        (None, None, SPECTRUM, "spectrum: only of a random force"),
    ],
)
def test_spectra_are_checked(level, excitation, spectrum, text) -> None:
    with pytest.raises(DataError, match=text):
        measure().with_level(level, excitation=excitation, spectrum=spectrum)


def test_a_spectrum_in_a_table_is_checked(tmp_path) -> None:
    path = tmp_path / "test.csv"
    updyn.write_frf(measure().with_level(6.0, excitation="random"), path)
    path.write_text(path.read_text().replace("# spectrum: 5.0 12.0", "# spectrum: 5.0 high"))
    with pytest.raises(FormatError, match="spectrum: expected pairs"):
        updyn.read_frf(path)


@pytest.mark.parametrize(("factor", "accepted"), [(1.0 + 0.9e-5, True), (1.0 + 1.1e-5, False)])
def test_a_level_is_that_of_the_spectrum_to_five_digits(factor, accepted) -> None:
    options = {"excitation": "random", "spectrum": SPECTRUM}
    if accepted:
        measure().with_level(factor * np.sqrt(1.5), **options)
        return
    with pytest.raises(DataError, match="its spectrum has the RMS"):
        measure().with_level(factor * np.sqrt(1.5), **options)
