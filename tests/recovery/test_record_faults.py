"""The study of benchmarks/quality.py on a few draws: faults are found, sound tests are left alone."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from places import ROOT


@pytest.fixture(scope="module")
def study():
    """The benchmark as a module."""
    sys.path.insert(0, str(ROOT / "benchmarks"))
    import quality

    yield quality
    sys.path.remove(str(ROOT / "benchmarks"))


def test_seeded_faults_are_found(study):
    for number, (kind, make) in enumerate(study.FAULTS.items()):
        for draw in range(2):
            found = study.looked_at(make(np.random.default_rng([0, number, draw])))
            assert kind in {one.kind for one in found}, draw


def test_sound_tests_are_left_alone(study):
    for draw in range(6):
        rng = np.random.default_rng([0, 99, draw])
        assert study.looked_at(study.recorded(study.drawn(rng), rng)) == ()
