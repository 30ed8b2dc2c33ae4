"""A cantilever of beams in equal segments, each a group."""

from updyn.elements.structure import Beam, rectangle, structure


def cantilever(segments, beams, length, grounded=(0,)):
    """Steel, 30 x 20 mm: `segments` groups of `beams` beams of a length in m each."""
    groups = [
        Beam(
            f"segment {s + 1}",
            [[i, i + 1] for i in range(beams * s, beams * s + beams)],
            2.1e11,
            7850.0,
            rectangle(0.03, 0.02),
            orientation=[0.0, 0.0, 1.0],
            loss_factor=0.01,
        )
        for s in range(segments)
    ]
    nodes = {i: [length * i, 0.0, 0.0] for i in range(segments * beams + 1)}
    return structure(nodes, groups, grounded=list(grounded))
