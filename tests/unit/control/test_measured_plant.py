"""Plants of measured FRFs: the measured beam, and noisy FRFs of a model that is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import updyn
import updyn.demos
from updyn.control.antiresonances import fill_antiresonances
from updyn.errors import DataError, DofError, OptionError

BEAM = Path(updyn.demos.__file__).parent / "data/ladisk_beam.uff"
DOFS = ["1:X", "2:X", "3:X"]


def chain() -> updyn.Model:
    """Three masses on springs, held."""
    K = np.array([[9e4, -4e4, 0.0], [-4e4, 7e4, -3e4], [0.0, -3e4, 3e4]])
    groups = {
        "k": updyn.Group(K, loss_factor=0.02),
        "m": updyn.Group(mass=np.diag([2.0, 1.0, 1.5])),
    }
    return updyn.Model.from_groups(groups, DOFS)


def noisy(share: float) -> updyn.FRF:
    """FRFs of the chain with noise, and its variance."""
    clean = updyn.response(chain(), np.linspace(5.0, 60.0, 800), DOFS, ["1:X"], "accelerance")
    rng = np.random.default_rng(1)
    size = share * np.abs(clean.values).max(axis=0)
    noise = rng.standard_normal((2, *clean.values.shape)) * size / 2**0.5
    return updyn.FRF(
        clean.freq,
        clean.values + noise[0] + 1j * noise[1],
        clean.responses,
        clean.references,
        "accelerance",
        variance=np.broadcast_to(size**2, clean.values.shape),
    )


def test_the_measured_beam() -> None:
    """Within 5 % off the dips; poles are the identified modes."""
    frf, band = updyn.read_frf(BEAM), (100.0, 1300.0)
    plant = updyn.plant(
        frf, ["201:Z"], ["101:Z", "102:Z"], band, 0.05, quantity="accelerance", route="rational"
    )
    data = frf.select(band=band, responses=plant.outputs, references=plant.inputs)
    eye = np.eye(plant.n_states)
    own = [
        plant.C @ np.linalg.solve(s * eye - plant.A, plant.B) + plant.D
        for s in 2j * np.pi * data.freq
    ]
    level = fill_antiresonances(data.freq, data.values)
    assert (np.abs(np.array(own) - data.values) / level).max() <= 0.05
    modes = updyn.identify_modes(frf, band=band)
    largest = np.argsort(np.linalg.norm(modes.shapes[:2], axis=0))[-3:]  # of the two responses
    assert modes.frequency[np.sort(largest)] == pytest.approx([177.0, 477.5, 933.0], rel=3e-3)
    for frequency in modes.frequency[largest]:
        assert np.abs(plant.modes / frequency - 1.0).min() < 0.003
    assert plant.poles.real.max() < 0.0
    assert plant.facts["source"] == "measurement"


def test_noise_is_not_modelled() -> None:
    """With a variance, three deviations are allowed: three modes, and close to the truth."""
    plant = updyn.plant(noisy(0.005), ["1:X"], DOFS, (5.0, 60.0), 0.03, quantity="accelerance")
    assert plant.facts["noise"] == "variance"
    assert plant.n_states <= 8
    freq = np.linspace(6.0, 58.0, 999)
    H = updyn.response(chain(), freq, DOFS, ["1:X"], "accelerance").values
    error = np.abs(plant.response(freq).values - H) / np.abs(H).max(axis=0)
    assert error.max() < 0.03
    truth = updyn.modes(chain(), 3).frequency
    for frequency in truth:
        assert np.abs(plant.modes / frequency - 1.0).min() < 0.003


def test_beside_the_plant_of_the_model() -> None:
    """Ports, quantities and band are the same, so that both may stand side by side."""
    motion = updyn.Port("stretch", {"2:X": 1.0, "1:X": -1.0})
    about = {"band": (5.0, 60.0), "tolerance": 0.05, "quantity": "receptance"}
    both = [updyn.plant(given, ["1:-X"], [motion], **about) for given in (noisy(1e-4), chain())]
    assert both[0].inputs == both[1].inputs
    assert both[0].output_units == both[1].output_units
    freq = np.linspace(6.0, 58.0, 200)
    one, other = (p.response(freq).values for p in both)
    assert (np.abs(one - other) / np.abs(other).max()).max() < 0.05


@pytest.mark.parametrize(
    ("change", "kind", "said"),
    [
        ({"outputs": ["4:X"]}, DofError, r"port '4:X' of the measurement: output 4:X is not"),
        ({"inputs": ["2:X"]}, DofError, r"port '2:X' of the measurement: input 2:X is not"),
        ({"band": (70.0, 80.0)}, DataError, r"0 lines of the measurement .*800 from 5 to 60 Hz"),
        ({"route": "modal"}, OptionError, r"a measurement requires route 'rational'"),
        ({"tolerance": 0.0}, OptionError, r"tolerance 0\.0; expected a share"),
    ],
)
def test_what_a_measurement_cannot_give(
    change: dict[str, object], kind: type[Exception], said: str
) -> None:
    given = {"inputs": ["1:X"], "outputs": ["1:X"], "band": (5.0, 60.0), "tolerance": 0.05} | change
    with pytest.raises(kind, match=said):
        updyn.plant(noisy(0.001), **given)
