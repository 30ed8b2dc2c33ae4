"""How well data can determine unknowns, from central differences of responses alone."""

import numpy as np

import updyn


def cramer_rao(unknowns, start, data, exact, variance):
    """Standard deviations for complex Gaussian noise of known variance: information 2 Re(J^H J / E|dH|^2)."""
    J = []
    for i in range(len(exact)):
        step = 1e-5 * np.eye(len(exact))[i]
        up, down = (
            updyn.response(
                unknowns.apply(start, exact + s * step), data.freq, data.responses, data.references
            )
            for s in (1, -1)
        )
        J.append(((up.values - down.values) / 2e-5 / np.sqrt(variance)).ravel())
    J = np.array(J)
    return np.sqrt(np.diag(np.linalg.solve(2.0 * (J @ J.conj().T).real, np.eye(len(exact)))))
