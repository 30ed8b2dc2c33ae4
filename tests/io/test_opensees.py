"""Models out of a running OpenSees, against its own eigenvalues and its own element stiffness."""

from __future__ import annotations

import atexit
import os

import numpy as np
import pytest

import updyn
from updyn.errors import ModelError, OptionError
from updyn.io.opensees import from_opensees

pytestmark = pytest.mark.kernels

# The wheel is bound to one version of Python and one system; where it does not load there is
# nothing to test.
ops = pytest.importorskip(
    "openseespy.opensees", reason="needs openseespy", exc_type=(ImportError, RuntimeError)
)


@atexit.register  # runs before OpenSees's own, which writes a line after the last one of the test run
def quiet() -> None:
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)


E, A, I, LINE_MASS = 2.0e11, 0.01, 1.0e-5, 78.0


@pytest.fixture(autouse=True)
def emptied():
    ops.wipe()
    yield
    ops.wipe()


def cantilever(n: int = 4, consistent: bool = False) -> None:
    ops.model("basic", "-ndm", 2, "-ndf", 3)
    for i in range(n + 1):
        ops.node(i + 1, 0.8 * i, 0.0)
    ops.fix(1, 1, 1, 1)
    ops.geomTransf("Linear", 1)
    for i in range(n):
        extra = ("-cMass",) if consistent else ()
        ops.element(
            "elasticBeamColumn", i + 1, i + 1, i + 2, A, E, I, 1, "-mass", LINE_MASS, *extra
        )


def eigen(n: int) -> np.ndarray:
    """Return natural frequencies in Hz as OpenSees computes them."""
    ops.wipeAnalysis()
    ops.constraints("Transformation")
    return np.sqrt(np.array(ops.eigen("-fullGenLapack", n))) / (2 * np.pi)


def frequencies(model: updyn.Model, n: int) -> np.ndarray:
    undamped = {
        name: updyn.Group(g.stiffness, g.mass)
        for name, g in model.groups.items()
        if name != "damping"
    }
    return updyn.modes(updyn.Model(undamped, model.dofs), n).frequency


def test_frequencies_of_a_beam():
    cantilever(6)
    model = from_opensees(ops)
    assert list(model.groups) == ["ElasticBeam2d"]
    assert model.dofs.labels[:4] == ["2:X", "2:Y", "2:RZ", "3:X"]
    np.testing.assert_allclose(frequencies(model, 4), eigen(4), rtol=1e-9)


def test_a_cantilever_by_hand():
    """One element with a mass at its tip: f = sqrt(3 E I / L^3 / m) / 2 pi, and K of a beam element by the textbook."""
    cantilever(1)
    ops.mass(2, 50.0, 50.0, 0.0)
    model = from_opensees(ops, {"beam": [1]})
    L = 0.8
    K = np.array(
        [
            [E * A / L, 0, 0],
            [0, 12 * E * I / L**3, -6 * E * I / L**2],
            [0, -6 * E * I / L**2, 4 * E * I / L],
        ]
    )
    np.testing.assert_allclose(model.group("beam").stiffness.toarray(), K, rtol=1e-12)
    np.testing.assert_array_equal(
        model.group("nodal mass").mass.toarray(), np.diag([50.0, 50.0, 0.0])
    )
    alone = updyn.Model({"beam": updyn.Group(K), "mass": model.group("nodal mass")}, model.dofs)
    assert updyn.modes(alone, 1).frequency[0] == pytest.approx(
        np.sqrt(3 * E * I / L**3 / 50.0) / (2 * np.pi), rel=1e-9
    )


def test_groups_are_exact():
    """Each group is the sum of its own elements; a group that OpenSees is given alone has the same matrices."""
    cantilever(4, consistent=True)
    both = from_opensees(ops, {"root": [1, 2], "tip": [3, 4]})
    ops.remove("element", 3)
    ops.remove("element", 4)
    for node in (4, 5):
        ops.remove("node", node)
    root = from_opensees(ops)
    rows = both.dofs.match(root.dofs).index
    for what in ("stiffness", "mass"):
        own = getattr(both.group("root"), what).toarray()[np.ix_(rows, rows)]
        np.testing.assert_allclose(own, getattr(root, what).toarray(), rtol=1e-12, atol=1e-6)
        assert own.any()


def test_a_changed_group_has_the_frequencies_of_a_changed_model():
    cantilever(4)
    model = from_opensees(ops, {"root": [1, 2], "tip": [3, 4]})
    changed = model.scaled({"tip": {"stiffness": 1.44, "mass": 0.8}})
    for tag in (3, 4):
        ops.remove("element", tag)
        ops.element(
            "elasticBeamColumn", tag, tag, tag + 1, A, 1.44 * E, I, 1, "-mass", 0.8 * LINE_MASS
        )
    np.testing.assert_allclose(frequencies(changed, 4), eigen(4), rtol=1e-9)


def test_elements_left_over_and_masses_by_name():
    cantilever(3)
    for node, m in ((2, 3.0), (3, 4.0), (4, 5.0)):
        ops.mass(node, m, m, 0.1)
    model = from_opensees(ops, {"root": [1]}, masses={"first": [2]})
    assert list(model.groups) == ["root", "remaining", "first", "nodal mass"]
    np.testing.assert_array_equal(
        model.group("first").mass.diagonal(), [3, 3, 0.1, 0, 0, 0, 0, 0, 0]
    )
    np.testing.assert_allclose(
        model.group("nodal mass").mass.diagonal(), [0, 0, 0, 4, 4, 0.1, 5, 5, 0.1], rtol=1e-12
    )
    np.testing.assert_allclose(frequencies(model, 4), eigen(4), rtol=1e-9)


def springs(rayleigh: bool) -> None:
    cantilever(3)
    ops.uniaxialMaterial("Elastic", 1, 4.0e6)
    for node, tag in ((3, 31), (4, 41)):
        ops.node(tag, 0.8 * (node - 1), 0.0)
        ops.fix(tag, 1, 1, 1)
        ops.element(
            "zeroLength",
            tag,
            tag,
            node,
            "-mat",
            1,
            "-dir",
            2,
            *(("-doRayleigh", 1) if rayleigh else ()),
        )


def test_springs():
    springs(rayleigh=True)
    model = from_opensees(ops, {"first": [31], "second": [41]})
    for name, dof in (("first", "3:Y"), ("second", "4:Y")):
        at = model.dofs.match([dof]).index[0]
        K = model.group(name).stiffness
        assert K.nnz == 1
        assert K[at, at] == pytest.approx(4.0e6, rel=1e-12)
    np.testing.assert_allclose(frequencies(model, 4), eigen(4), rtol=1e-9)


def test_springs_without_rayleigh_damping_in_one_group():
    """zeroLength leaves it out unless told: what is left of the total is theirs, if they are the only ones."""
    springs(rayleigh=False)
    model = from_opensees(ops, {"springs": [31, 41]})
    at = model.dofs.match(["3:Y", "4:Y"]).index
    expected = np.zeros(model.n_dofs)
    expected[at] = 4.0e6
    np.testing.assert_allclose(
        model.group("springs").stiffness.toarray(), np.diag(expected), rtol=1e-12
    )
    np.testing.assert_allclose(frequencies(model, 4), eigen(4), rtol=1e-9)


def test_springs_without_rayleigh_damping_in_two_groups():
    springs(rayleigh=False)
    with pytest.raises(
        ModelError,
        match=r"differ by .*4e\+06 at [34]:Y, [34]:Y.*'first': ZeroLength 31; 'second': ZeroL.*'-doRa",
    ):
        from_opensees(ops, {"first": [31], "second": [41]})


def test_a_truss():
    """Bars take no Rayleigh damping by default; a type of its own, they still come out."""
    ops.model("basic", "-ndm", 3, "-ndf", 3)
    corners = [(0, 0, 0), (2, 0, 0), (0, 2, 0), (0.5, 0.5, 1.5)]
    for i, corner in enumerate(corners):
        ops.node(i + 1, *map(float, corner))
    for i in (1, 2, 3):
        ops.fix(i, 1, 1, 1)
    ops.uniaxialMaterial("Elastic", 1, 7.0e10)
    for i in (1, 2, 3):
        ops.element("truss", i, i, 4, 1e-4, 1, "-rho", 0.27)
    ops.mass(4, 2.0, 2.0, 2.0)
    model = from_opensees(ops)
    assert list(model.groups) == ["Truss", "nodal mass"]
    K = np.zeros((3, 3))
    for corner in corners[:3]:
        d = np.subtract(corners[3], corner)
        K += 7.0e10 * 1e-4 / np.linalg.norm(d) ** 3 * np.outer(d, d)
    np.testing.assert_allclose(model.stiffness.toarray(), K, rtol=1e-11, atol=1e-5)
    lengths = sum(np.linalg.norm(np.subtract(corners[3], c)) for c in corners[:3])
    np.testing.assert_allclose(model.mass.diagonal(), 2.0 + 0.27 * lengths / 2, rtol=1e-12)
    np.testing.assert_allclose(model.geometry.position([4]), [[0.5, 0.5, 1.5]])
    np.testing.assert_array_equal(model.geometry.lines, [[1, 4], [2, 4], [3, 4]])


def test_plane_elements_have_faces():
    ops.model("basic", "-ndm", 2, "-ndf", 2)
    for i, corner in enumerate([(0, 0), (1, 0), (1, 1), (0, 1), (2, 0)]):
        ops.node(i + 1, *map(float, corner))
    ops.fix(1, 1, 1)
    ops.nDMaterial("ElasticIsotropic", 1, 7.0e10, 0.3, 2700.0)
    ops.element("quad", 1, 1, 2, 3, 4, 0.01, "PlaneStress", 1)
    ops.element("tri31", 2, 2, 5, 3, 0.01, "PlaneStress", 1)
    ops.mass(2, 1.0, 1.0)
    model = from_opensees(ops)
    assert model.geometry.faces.tolist() == [[1, 2, 3, 4], [2, 5, 3, 3]]
    assert len(model.geometry.lines) == 6


@pytest.mark.parametrize("tie", ["all", "some", "rigid"])
def test_tied_nodes(tie):
    """Constraints are condensed out as OpenSees does it; a node tied in part keeps the rest."""
    cantilever(3)
    ops.node(10, 2.4, 0.6 if tie == "rigid" else 0.0)
    ops.element("elasticBeamColumn", 9, 10, 2, A, E, I, 1, "-mass", LINE_MASS)
    ops.mass(10, 7.0, 7.0, 0.5)
    if tie == "rigid":
        ops.rigidLink("beam", 4, 10)
    else:
        ops.equalDOF(4, 10, *((1, 2, 3) if tie == "all" else (1, 2)))
    model = from_opensees(ops, {"beam": [1, 2, 3], "branch": [9]})
    assert ("10:RZ" in model.dofs) == (tie == "some")
    assert "10:X" not in model.dofs
    np.testing.assert_allclose(frequencies(model, 4), eigen(4), rtol=1e-9)


def test_damping_is_kept_as_it_is():
    cantilever(2)
    ops.uniaxialMaterial("Viscous", 5, 30.0, 1.0)
    ops.node(20, 0.8, 0.0)
    ops.fix(20, 1, 1, 1)
    ops.element("zeroLength", 20, 20, 2, "-mat", 5, "-dir", 2)
    ops.rayleigh(0.5, 0.0, 0.0, 0.0)
    model = from_opensees(ops, {"beam": [1, 2]})
    C = model.group("damping").viscous.toarray()
    dashpot = np.zeros_like(C)
    at = model.dofs.match(["2:Y"]).index[0]
    dashpot[at, at] = 30.0
    np.testing.assert_allclose(C, 0.5 * model.mass.toarray() + dashpot, rtol=1e-12)
    assert list(model.groups) == ["beam", "damping"]  # the dashpot has neither stiffness nor mass


def test_rayleigh_factors_at_the_end():
    cantilever(2)
    ops.rayleigh(0.5, 0.0, 0.0, 0.0)
    from_opensees(ops, rayleigh=(0.25, 0.0, 0.0, 0.0))
    again = from_opensees(ops)
    np.testing.assert_allclose(
        again.group("damping").viscous.toarray(), 0.25 * again.mass.toarray(), rtol=1e-12
    )
    assert "damping" not in from_opensees(ops).groups


def test_the_model_is_left_as_it_was():
    cantilever(3)
    ops.mass(4, 3.0, 2.0, 0.1)
    ops.timeSeries("Linear", 1)
    ops.pattern("Plain", 1, 1)
    ops.load(4, 0.0, -1000.0, 0.0)
    ops.system("BandGeneral")
    ops.constraints("Plain")
    ops.integrator("LoadControl", 1.0)
    ops.algorithm("Linear")
    ops.analysis("Static", "-noWarnings")
    assert ops.analyze(1) == 0
    before = [ops.nodeDisp(n) for n in ops.getNodeTags()]
    from_opensees(ops, {"root": [1]})
    assert [ops.nodeDisp(n) for n in ops.getNodeTags()] == before
    assert ops.getTime() == 1.0
    assert ops.nodeMass(4) == [3.0, 2.0, 0.1]
    # P L^3 / 3 E I
    assert ops.nodeDisp(4, 2) == pytest.approx(-1000.0 * 2.4**3 / (3 * E * I), rel=1e-9)


def test_free_in_space():
    """Without supports: rigid body modes, and no word about a singular matrix."""
    ops.model("basic", "-ndm", 3, "-ndf", 6)
    for i in range(3):
        ops.node(i + 1, 0.0, 0.0, 0.5 * i)
    ops.geomTransf("Linear", 1, 1.0, 0.0, 0.0)
    for i in (1, 2):
        ops.element(
            "elasticBeamColumn",
            i,
            i,
            i + 1,
            A,
            E,
            8e10,
            2e-5,
            I,
            3e-5,
            1,
            "-mass",
            LINE_MASS,
            "-cMass",
        )
    model = from_opensees(ops)
    assert model.dofs.labels[:6] == ["1:X", "1:Y", "1:Z", "1:RX", "1:RY", "1:RZ"]
    moved = np.tile([1.0, 0, 0, 0, 0, 0], 3)
    assert np.abs(model.stiffness @ moved).max() < 1e-6 * abs(model.stiffness).max()
    assert moved @ model.mass @ moved == pytest.approx(LINE_MASS * 1.0, rel=1e-12)


def test_units():
    """The beam in mm, N and t is the beam in m."""
    cantilever(2)
    si = from_opensees(ops)
    ops.wipe()
    ops.model("basic", "-ndm", 2, "-ndf", 3)
    for i in range(3):
        ops.node(i + 1, 800.0 * i, 0.0)
    ops.fix(1, 1, 1, 1)
    ops.geomTransf("Linear", 1)
    for i in range(2):
        ops.element(
            "elasticBeamColumn",
            i + 1,
            i + 1,
            i + 2,
            A * 1e6,
            E / 1e6,
            I * 1e12,
            1,
            "-mass",
            LINE_MASS * 1e-6,
        )
    mm = from_opensees(ops, unit="mm")
    np.testing.assert_allclose(mm.stiffness.toarray(), si.stiffness.toarray(), rtol=1e-9)
    np.testing.assert_allclose(mm.mass.toarray(), si.mass.toarray(), rtol=1e-12)
    np.testing.assert_allclose(mm.geometry.xyz, si.geometry.xyz)


def test_recovery():
    """Two spans and a joint, changed and found again."""
    springs(rayleigh=True)
    start = from_opensees(
        ops, {"root": [1], "rest": [2, 3], "joint": [31], "tip spring": [41]}, loss_factor=0.02
    )
    truth = {"root": 0.9, "rest": 1.08, "joint": 1.3}
    frf = updyn.response(
        start.scaled({n: {"stiffness": v} for n, v in truth.items()}),
        np.linspace(5, 600, 60),
        ["3:Y", "4:Y", "2:Y"],
        ["4:Y"],
    )
    result = updyn.update(
        start, frf, updyn.parameters(start, stiffness=list(truth)), noise={"relative": 1e-6}
    )
    assert result.status == "converged"
    for name, value in truth.items():
        assert result.values[f"{name}.stiffness"] == pytest.approx(value, rel=1e-6)


class TestErrors:
    def test_nothing_in_it(self):
        with pytest.raises(ModelError, match="no element"):
            from_opensees(ops)

    def test_all_fixed(self):
        cantilever(1)
        ops.fix(2, 1, 1, 1)
        with pytest.raises(ModelError, match="every degree of freedom is fixed"):
            from_opensees(ops)

    def test_pressures(self):
        """Three degrees of freedom in 2D, of which the third is no rotation."""
        ops.model("basic", "-ndm", 2, "-ndf", 3)
        for i, (x, y) in enumerate([(0, 0), (1, 0), (1, 1), (0, 1)]):
            ops.node(i + 1, float(x), float(y))
        ops.fix(1, 1, 1, 1)
        ops.fix(2, 1, 1, 1)
        ops.nDMaterial("ElasticIsotropic", 1, 1e7, 0.3, 2000.0)
        ops.element("quadUP", 1, 1, 2, 3, 4, 1.0, 1, 2.2e9, 1000.0, 1e-6, 1e-6)
        with pytest.raises(ModelError, match=r"element 1 \(.*UP\) has pore pressures"):
            from_opensees(ops)

    def test_degrees_of_freedom_without_a_name(self):
        cantilever(2)
        ops.node(9, 0.0, 1.0, "-ndf", 4)
        with pytest.raises(ModelError, match="node 9 has 4 degrees of freedom in 2 dimensions"):
            from_opensees(ops)

    @pytest.mark.parametrize(
        ("options", "said"),
        [
            ({"groups": {"a": [9]}}, "no element 9; nearest: 3, 2, 1"),
            ({"groups": {"a": [1], "b": [1]}}, "element 1 is in 'a' and in 'b'"),
            ({"groups": {"a": []}}, "'a' is empty"),
            ({"groups": {"remaining": [1]}}, "'remaining' is reserved"),
            ({"groups": {"damping": [1]}}, "'damping' occurs twice"),
            ({"groups": [1, 2]}, "expected a mapping of name to element tags, found list"),
            ({"masses": {"a": [2]}}, "node 2 has no mass"),
            ({"masses": {"a": [99]}}, "no node 99"),
            ({"unit": "inch"}, "unit 'inch'"),
            ({"rayleigh": (0.0,)}, "expected alphaM"),
        ],
    )
    def test_bad_options(self, options, said):
        cantilever(3)
        with pytest.raises(OptionError, match=said):
            from_opensees(ops, **options)

    def test_not_opensees(self):
        with pytest.raises(OptionError, match="expected the module openseespy"):
            from_opensees(np)
