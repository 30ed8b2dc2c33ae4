"""An undetermined case and its remedies: two springs in series with no sensor between them.

A flange of negligible mass couples two shafts. Measurements on the shafts depend only on the sum of
the two compliances 1/k1 + 1/k2: one spring may become stiffer as the other becomes softer. The
result states the undetermined combination, the determined one, and an advice for the experiment:
here a sensor on the flange, or one spring known from another test.

Run it with ``python examples/undetermined.py``.
"""

from __future__ import annotations

import numpy as np

import updyn

TRUTH = {"coupling 1": {"stiffness": 0.7}, "coupling 2": {"stiffness": 1.2}}


def spring(i: int, j: int, k: float) -> np.ndarray:
    """Return the stiffness of a torsional spring between two of the three DOFs, in N m/rad."""
    K = np.zeros((3, 3))
    K[[i, j], [i, j]] = k
    K[[i, j], [j, i]] = -k
    return K


def drive() -> updyn.Model:
    """Return motor - coupling 1 - flange - coupling 2 - load; only motor and load have inertia."""
    return updyn.Model.from_groups(
        {
            "inertia": updyn.Group(mass=np.diag([0.02, 0.0, 0.05])),
            "coupling 1": updyn.Group(stiffness=spring(0, 1, 2000.0), loss_factor=0.02),
            "coupling 2": updyn.Group(stiffness=spring(1, 2, 3000.0), loss_factor=0.02),
        },
        ["1:RZ", "2:RZ", "3:RZ"],
    )


def measure(model: updyn.Model, responses: list[str]) -> updyn.FRF:
    """Return mobilities of the true drive for a torque on the motor, with 1 % noise."""
    exact = updyn.response(
        model.scaled(TRUTH), np.linspace(5.0, 60.0, 111), responses, ["1:RZ"], quantity="mobility"
    )
    rng = np.random.default_rng(7)
    real, imaginary = rng.normal(size=(2, *exact.values.shape)) / np.sqrt(2.0)
    values = exact.values * (1.0 + 0.01 * (real + 1j * imaginary))
    return updyn.FRF(exact.freq, values, responses, ["1:RZ"], "mobility")


def show(title: str, result: updyn.UpdateResult) -> None:
    """Print status, values and identifiability of a result."""
    ident = result.identifiability
    print(f"{title}\n  status: {result.status}, rank {ident.rank} of {ident.n_parameters}")
    for name, value in result.values.items():
        print(f"  {name} = {value:.4f}, standard deviation {result.std[name]:.2g}")
    for direction in ident.null_directions:
        print("  undetermined: " + ", ".join(f"{w:+.3g} {name}" for name, w in direction.items()))
    for direction in ident.determined_directions:
        print("  determined: " + ", ".join(f"{w:+.3g} {name}" for name, w in direction.items()))
    print(f"  advice: {ident.advice or 'none needed'}\n")


def main() -> None:
    """Show the undetermined combination, then two remedies."""
    model = drive()
    both = updyn.parameters(model, stiffness=["coupling*"])

    shafts = updyn.update(model, measure(model, ["1:RZ", "3:RZ"]), both)
    show("Sensors on motor and load", shafts)
    assert shafts.status == "not-identifiable"
    assert shafts.identifiability.rank == 1
    # The determined combination, the sum of the compliances, is correct all the same.
    k1 = 2000.0 * shafts.values["coupling 1.stiffness"]
    k2 = 3000.0 * shafts.values["coupling 2.stiffness"]
    compliance = 1.0 / k1 + 1.0 / k2
    true = 1.0 / (2000.0 * 0.7) + 1.0 / (3000.0 * 1.2)
    print(f"  1/k1 + 1/k2 is {compliance:.4g} rad/(N m), true {true:.4g}\n")
    assert abs(compliance / true - 1.0) < 0.01

    flange = updyn.update(model, measure(model, ["1:RZ", "2:RZ", "3:RZ"]), both)
    show("A sensor on the flange", flange)
    assert flange.ok

    known = model.scaled({"coupling 2": {"stiffness": 1.2}})  # from a static test of that coupling
    one = updyn.update(
        known, measure(model, ["1:RZ", "3:RZ"]), updyn.parameters(known, stiffness=["coupling 1"])
    )
    show("Coupling 2 known from a static test", one)
    assert one.ok


if __name__ == "__main__":
    main()
