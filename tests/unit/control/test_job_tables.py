"""`[plant]` and `[servo]` of a job: what they mean, and what they refuse, with lines and the nearest valid choice."""

import tomllib

import pytest

from updyn.control.job.checks import band_of_plant, beyond_the_data
from updyn.control.servo.controller import Controller, Notch
from updyn.control.servo.wind import Wind
from updyn.demos import find_demo
from updyn.errors import JobError
from updyn.job import load_job, prepare
from updyn.job.folder import format_resolved_job

JOB = """[model]
file = "chain.h5"
[test]
file = "chain.uff"
[[parameter]]
groups = ["part1"]
quantity = "stiffness"
[plant]
"""
PORTS = 'inputs = ["12:X"]\noutputs = ["5:X"]\n'


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("control")
    find_demo("chain").write_inputs(folder)
    return folder


@pytest.fixture
def job(folder):
    def make(table):
        path = folder / "job.toml"
        path.write_text(JOB + table)
        return path

    return make


def test_labels_and_tables_become_ports(job):
    text = (
        'inputs = ["12:-X", { name = "drive", dof = "2:X", ratio = 40 }]\noutputs = { name ='
        ' "twist", weights = { "5:X" = 1, "2:X" = -0.5 } }\nquantity = "mobility"\n'
    )
    ready = prepare(load_job(job(text)))
    table = ready.job.tables["plant"]
    assert [p.name for p in table.input_ports] == ["12:-X", "drive"]
    assert dict(table.input_ports[1].weights) == {"2:X": 1 / 40}
    assert dict(table.output_ports[0].weights) == {"5:X": 1.0, "2:X": -0.5}
    assert table.quantities == ("mobility",)
    assert band_of_plant(ready.job, ready.tests[0].freq) == pytest.approx(
        (ready.tests[0].freq[0], ready.tests[0].freq[-1])
    )


def test_what_is_written_out_says_the_same(job, tmp_path):
    text = (
        'inputs = ["12:X"]\noutputs = [{ name = "twist", weights = { "5:X" = 1, "2:X" = -1 } },'
        ' "5:X"]\nquantity = ["mobility", "receptance"]\nband = [1, 9]\nsampling = { dt = 0.01,'
        " delay = 0.015 }\nfamily = 3\n"
    )
    loaded = load_job(job(text))
    written = format_resolved_job(loaded, tmp_path)
    assert tomllib.loads(written)["plant"]["band"] == [1.0, 9.0]
    (tmp_path / "again.toml").write_text(written)
    again = load_job(tmp_path / "again.toml").tables["plant"]
    assert again == loaded.tables["plant"]
    assert again.sampled_files == ("plant-sampled.mat", "plant-sampled.json", "plant-sampled.h")


def test_a_band_beyond_the_data_is_said(job):
    ready = prepare(load_job(job(PORTS + "band = [1.0, 90.0]\n")))
    said = beyond_the_data(band_of_plant(ready.job, ready.tests[0].freq), ready.tests[0].freq)
    assert "1 to 90 Hz, extends beyond the data, 0.63" in said
    assert beyond_the_data((1.0, 20.0), ready.tests[0].freq) == ""


@pytest.mark.parametrize(
    ("table", "line", "said"),
    [
        (
            'input = ["12:X"]\noutputs = ["5:X"]\n',
            9,
            "unknown key 'input' in [plant]; did you mean 'inputs'",
        ),
        ('outputs = ["5:X"]\n', 8, "missing key 'inputs' in [plant]"),
        ('inputs = ["12:X"]\noutputs = []\n', 10, "expected outputs: labels"),
        ('inputs = ["12:Q"]\noutputs = ["5:X"]\n', 9, "DOF '12:Q': expected node:direction"),
        ('inputs = ["12:X"]\noutputs = ["15:X"]\n', 10, "15:X"),
        (
            'inputs = [\n"12:X",\n{ dof = "2:X", ration = 4 }]\noutputs = ["5:X"]\n',
            11,
            "did you mean 'ratio'",
        ),
        ('inputs = [{ dof = "2:X", ratio = 0 }]\noutputs = ["5:X"]\n', 9, "gear ratio 0"),
        (
            'inputs = [{ weights = { "2:X" = 1 } }]\noutputs = ["5:X"]\n',
            9,
            "weights without a name",
        ),
        (
            'inputs = [{ name = "a" }]\noutputs = ["5:X"]\n',
            9,
            "expected either dof or weights by DOF",
        ),
        ('inputs = ["12:X"]\noutputs = ["5:X",\n"5:X"]\n', 11, "two outputs are named '5:X'"),
        (PORTS + 'quantity = "mobilty"\n', 11, "did you mean 'mobility'"),
        (
            PORTS + 'quantity = ["mobility", "mobility"]\n',
            11,
            "2 given; expected one, or one for each of the outputs, 1",
        ),
        (PORTS + "band = [9.0, 1.0]\n", 11, "the lower one first"),
        (PORTS + "tolerance = 0\n", 11, "expected a number of at least 1e-09"),
        (PORTS + "tolerance = 2\n", 11, "expected a number of at most 0.5"),
        (PORTS + 'route = "modl"\n', 11, "did you mean 'modal'"),
        (
            PORTS + "sampling = { dt = 0.1 }\n",
            11,
            "half the rate is 5 Hz, below the end of the plant's band, 22.7 Hz",
        ),
        (
            PORTS + "sampling = { dt = 0.1, metod = 1 }\n",
            11,
            "unknown key 'metod' in [plant.sampling]",
        ),
        (PORTS + 'files = ["plant.matt"]\n', 11, "did you mean '.mat'"),
        (PORTS + 'files = ["result.json"]\n', 11, "expected the name of another file"),
        (PORTS + 'files = ["a.h", "A.h"]\n', 11, "two of the files have the same name"),
        (PORTS + 'test = "first"\n', 11, "this job has one"),
    ],
)
def test_what_is_wrong_is_said_with_its_line(job, table, line, said):
    with pytest.raises(JobError, match=f"job.toml:{line}: .*") as caught:
        prepare(load_job(job(table)))
    assert said in str(caught.value)


# -- [servo] ---------------------------------------------------------------------------------------------------
LOOP = (
    'inputs = [{ name = "M", dof = "12:X" }, { name = "gust", dof = "5:X" }]\n'
    'outputs = [{ name = "speed", dof = "12:X" }, { name = "angle", dof = "12:X" }]\n'
    'quantity = ["mobility", "receptance"]\n[servo]\n'
)


def test_a_controller_is_that_of_the_library(job, tmp_path):
    text = (
        'torque = "M"\nvelocity = "speed"\nposition = "angle"\ndisturbance = "gust"\nwind = {'
        " mean_speed = 10, coefficient = 0.5, turbulence = 0.2 }\n[servo.controller]\nkp = 20\nti ="
        " 0.1\nkv = 3\nlow_pass = 50\ndead_time = 0.001\n[[servo.controller.notch]]\nfrequency ="
        " 7\n[[servo.controller.notch]]\nfrequency = 9\nwidth = 2\ndepth = 0.1\n"
    )
    loaded = load_job(job(LOOP + text))
    found = loaded.tables["servo"].controller.controller(None, "M", "speed", "angle")
    notches = (Notch(7.0), Notch.of_width(9.0, 2.0, 0.1))
    assert found == Controller(20.0, 0.1, 3.0, notches, low_pass=50.0, dead_time=0.001)
    assert loaded.tables["servo"].wind.wind() == Wind(10.0, 0.5, turbulence=0.2)
    (tmp_path / "again.toml").write_text(format_resolved_job(loaded, tmp_path))
    assert load_job(tmp_path / "again.toml").tables["servo"] == loaded.tables["servo"]


CONTROLLER = 'torque = "M"\nvelocity = "speed"\n[servo.controller]\n'


@pytest.mark.parametrize(
    ("table", "line", "said"),
    [
        ('torqe = "M"\n', 13, "unknown key 'torqe' in [servo]; did you mean 'torque'"),
        ('torque = "N"\n', 13, "the plant has no input with that name; valid: 'M', 'gust'"),
        ('torque = "M"\nvelocity = "sped"\n', 14, "did you mean 'speed'"),
        (
            'velocity = "speed"\ncontroller = { kp = 1 }\n',
            12,
            "missing key 'torque': expected one of 'M', 'gust'",
        ),
        ('torque = "M"\ncontroller = { kp = 1 }\n', 12, "missing key 'velocity'"),
        (
            'torque = "M"\nvelocity = "speed"\n',
            13,
            "expected [servo.controller] with kp or crossover, or motor and",
        ),
        ('motor = "12:X"\n', 12, "expected motor and load"),
        ('motor = "12:X"\nload = "13:X"\n', 14, "load 13:X is not among the 12 DOFs"),
        ("ratio = 3\n", 13, "servo.ratio is checked with motor and load"),
        (CONTROLLER, 15, "expected either kp, or crossover to size it by rule"),
        (
            CONTROLLER + "kp = 1\ncrossover = 3\n",
            16,
            "expected either kp, or crossover to size it by rule",
        ),
        (CONTROLLER + "kp = 1\nti_ratio = 3\n", 17, "ti_ratio sizes a gain by rule"),
        (CONTROLLER + "crossover = 1\nratio = 0\n", 17, "ratio is 0.0; expected a number other"),
        (CONTROLLER + "crossover = -3\n", 16, "crossover is -3.0; expected a number above 0"),
        (CONTROLLER + "kp = 1\nti = 0\n", 17, "ti is 0.0; expected a number above 0, in s"),
        (
            CONTROLLER + "kp = 1\ndeadtime = 0\n",
            17,
            "unknown key 'deadtime' in [servo.controller]; did you mean 'dead_",
        ),
        (CONTROLLER + "kp = 1\nfeed_forward = 0.5\n", 17, "feed_forward without kv"),
        (
            CONTROLLER + "kp = 1\nnotch = { frequency = 3 }\n",
            17,
            "write [[servo.controller.notch]]",
        ),
        (
            CONTROLLER + "kp = 1\n[[servo.controller.notch]]\nfrequency = 3\nwidth = -1\n",
            19,
            "width is -1.0",
        ),
        (
            CONTROLLER + "kp = 1\n[[servo.controller.notch]]\nfrequency = 3\ndepth = 1\n",
            19,
            "expected width with depth",
        ),
        ("wind = { mean_speed = 9, coefficient = 1 }\n", 13, "servo.wind without disturbance"),
        (
            'disturbance = "gust"\nwind = { mean_speed = 9, coefficient = 1 }\n',
            14,
            "expected roughness or turbulence",
        ),
        (
            CONTROLLER + 'kp = 1\n[[servo.nonlinear]]\nkind = "backlsh"\nat = "5:X"\n',
            18,
            "did you mean 'backlash'",
        ),
        (
            CONTROLLER + 'kp = 1\n[[servo.nonlinear]]\nkind = "backlash"\nat = "5:X"\ngap = 1\n',
            18,
            "needs mesh",
        ),
        (
            CONTROLLER
            + 'kp = 1\n[[servo.nonlinear]]\nkind = "friction"\nat = "5:X"\nlevel = 1\ngap = 1\n',
            21,
            "belong",
        ),
        (
            CONTROLLER
            + 'kp = 1\n[[servo.nonlinear]]\nkind = "backlash"\nat = "5:X"\nmesh = "prat2"\ngap'
            " = 1\n",
            20,
            "part2",
        ),
        (
            CONTROLLER + 'kp = 1\n[[servo.nonlinear]]\nkind = "friction"\nat = "55:X"\nlevel = 1\n',
            19,
            "55:X is not",
        ),
        ("step = 1\nduration = -1\n", 14, "expected a number above 0"),
        ("step = 0\n", 13, "servo.step = 0: expected a number other than 0"),
    ],
)
def test_what_is_wrong_with_a_servo_is_said_with_its_line(job, table, line, said):
    with pytest.raises(JobError, match=f"job.toml:{line}: .*") as caught:
        prepare(load_job(job(LOOP + table)))
    assert said in str(caught.value)


def test_a_servo_needs_a_plant(job):
    path = job("")
    path.write_text(path.read_text().replace("[plant]", '[servo]\nmotor = "12:X"\nload = "5:X"'))
    with pytest.raises(JobError, match=r"job.toml:8: \[servo\] without \[plant\]"):
        load_job(path)
