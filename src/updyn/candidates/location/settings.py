"""Numbers that decide the place and the kind of a local nonlinearity."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["LOCATION"]


@dataclass(frozen=True)
class LocationSettings:
    """Numbers of the search for the place and the kind of a nonlinear element."""

    #: [1] Error of a describing function relative to it, which neglects the higher harmonics of
    #: the motion. Effort: candidates are ranked by it only before they are fitted exactly.
    describing_error: float = 0.05
    #: [points] Amplitudes at which a describing function is tabulated. Effort: between them, it is
    #: interpolated with errors far below `describing_error`.
    table_points: int = 80
    #: [samples] Samples of a period for that. Effort: the same.
    samples: int = 128
    #: [1] Smallest tabulated amplitude over the largest. Effort: at smaller ones, the element is
    #: described by this one.
    least_amplitude: float = 1e-6
    #: [1] Noise of a measured deformation, relative to it, above which it is replaced
    #: by that without the element. Effort: candidates are only ranked by it.
    noisy_amplitude: float = 0.5
    #: [1] Relative error of the force of an element of the model, over that of the responses.
    #: Effort: the force of a cubic spring changes three times as much as its deformation.
    force_error: float = 3.0
    #: [1] Smallest force for that over the largest of the level. Effort: a gap has none while it is
    #: open.
    least_force: float = 0.1
    #: [1] Smallest effect of a combination of forces on the responses over the largest, from which
    #: it is determined. Rounding: the others have no effect on any response.
    least_effect: float = 1e-10
    #: [steps] Steps of the fit of a place. Effort: the best places need less than half of them.
    place_steps: int = 30
    #: [steps] Steps of the fit of a kind to its describing function. Effort: the same.
    kind_steps: int = 40
    #: [steps] Steps of an exact fit. Effort: the same.
    exact_steps: int = 25
    #: [1] Relative size of a step that ends a fit. Effort: further steps change the odds by far
    #: less than 1.
    tolerance: float = 1e-8
    #: [1] The same of the fit of a kind to its describing function. Effort: it ranks candidates.
    kind_tolerance: float = 1e-6
    #: [1] Predicted decrease of half the sum of squares, in units of the noise, that ends a fit.
    #: Effort: it changes the logarithm of the odds by as much.
    least_decrease: float = 1e-3
    #: [1] Step of the numerical derivative of a tabulated describing function. Rounding: between
    #: the rounding and the curvature of smooth functions.
    derivative_step: float = 1e-5
    #: [1] Error relative to |H| that widens the minima of linear unknowns in further descents.
    #: Effort: the last descent is that of the noise.
    soft_error: float = 0.3
    #: [places] Places with the smallest residuals at which further starts are tried. Effort: only
    #: if no place leaves a residual like noise.
    most_searched: int = 10
    #: [rounds] Rounds of the estimate of unstated noise by the residual of the best place. Effort:
    #: they end when that place remains the best.
    noise_rounds: int = 4
    #: [1] Smallest estimated noise relative to |H| and to its rms. Why: harmonics that periodic
    #: responses neglect change the first one by less (a slider: 4e-6).
    least_noise: float = 1e-5
    #: [starts] Further starts of the linear unknowns. Effort: the same.
    starts: int = 8
    #: [1] Largest distance of these starts, in the logarithm of a factor and in loss factors.
    #: Effort: usual errors of models.
    start_spread: tuple[float, float] = (0.4, 0.03)
    #: [places] Places whose kinds are compared by describing functions. Effort: places with a
    #: larger residual are left out by `excluded_log_odds` in nearly all cases.
    most_places: int = 8
    #: [1] Mean square of the misfit of a describing function, from which linear unknowns are fitted
    #: together with it. Effort: that of the right kind is at most about 4 if they are right.
    joint_misfit: float = 10.0
    #: [rounds] Rounds of that fit, each with the amplitudes of the one before. Effort: two change
    #: the estimate by less than the error of describing functions.
    rounds: int = 2
    #: [1] Logarithm of the odds against a place without any kind, from which no kind is tried there
    #: if another candidate fits. Effort: the fit without a kind is a bound of that with one.
    excluded_log_odds: float = 50.0
    #: [steps] Steps after which an exact fit is given up if its cost is far above another one.
    #: Effort: the right candidate is near its minimum then.
    hopeless_steps: int = 5
    #: [1] That cost over the least. Effort: candidates as bad are excluded at any odds.
    hopeless_ratio: float = 20.0
    #: [1] Shares of the force of an element by describing functions from which an exact fit starts,
    #: in this order, if there is no periodic motion at one of the lines. Effort: a weaker element
    #: has one.
    start_shares: tuple[float, ...] = (1.0, 0.8, 0.5, 0.2)
    #: [1] Misfit of the response at the start over that by describing functions, from which lines
    #: are taken to lack the measured branch. Effort: neglected harmonics cause less.
    branch_misfit: float = 4.0
    #: [rounds] Descents with the weights of such lines reduced. Effort: the third is near the
    #: minimum.
    branch_rounds: int = 3
    #: [places] Places at which the best kind is fitted exactly. Effort: see `most_places`.
    fitted_places: int = 5
    #: [places] The best of these, at which other kinds are fitted exactly, too. Effort: the same.
    compared_places: int = 2
    #: [kinds] Kinds that are fitted exactly at one place. Effort: the best by describing functions.
    most_kinds: int = 4
    #: [kinds] The best of these, which are fitted whatever their misfit. Effort: odds need two.
    least_kinds: int = 2
    #: [1] Misfit of describing functions over the smallest, from which others are not fitted
    #: exactly. Effort: the errors of describing functions are far smaller.
    largest_misfit: float = 20.0
    #: [1] Scale of the start of an element: its stiffness over that of the structure at its
    #: deformation. Effort: the fits to describing functions converge from far away.
    start_stiffness: float = 0.3
    #: [1] Smallest stiffness for that, over the former. Effort: weaker elements have no odds.
    least_stiffness: float = 1e-5
    #: [fits] Exact fits that are repeated with wider minima. Effort: only if no candidate leaves a
    #: residual like noise.
    refits: int = 3
    #: [1] Smallest stiffness of a connection over the largest. Rounding: sums of stiffnesses that
    #: vanish.
    least_coupling: float = 1e-9
    #: [places] Largest number of places that are candidates by default. Effort: one fit each.
    most_default_places: int = 500
    #: [1] Factor between the start and the bounds of a parameter of a polynomial, which may be 0.
    #: Default: wide.
    polynomial_bound: float = 30.0
    #: [1] Bounds of chi of an Iwan joint. Why: at most 0 for joints (Segalman 2005); at -1, it has
    #: no stiffness.
    chi_bounds: tuple[float, float] = (-0.95, 0.0)
    #: [1] Bounds of beta of an Iwan joint. Why: it is below 1 for joints, and a Jenkins element far
    #: above.
    beta_bounds: tuple[float, float] = (0.01, 10.0)
    #: [1] Ratio of the variance of the residual to that of the noise up to which the residual is
    #: consistent with noise. Why: an estimated variance is known to 15 %.
    largest_inflation: float = 1.2
    #: [elements] Largest number of elements that are sought. Default: each adds several searches.
    most_elements: int = 3
    #: [places] Places that the summary shows. Drawing: the first ones.
    shown_places: int = 8


LOCATION = LocationSettings()
