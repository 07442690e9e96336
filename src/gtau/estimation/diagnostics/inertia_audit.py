"""Audit of the robot file's inertias against the data: their prediction errors and contradictions.

The file's parameters are summed to base parameters, which the motions determine. Where the motions do not determine
some of these, the file's are regrouped with the others as the data regroup them. Friction, offsets, payloads and gains
are as identified on both sides. A rotor inertia that the file does not state may take any value that is not negative.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from gtau.estimation.diagnostics.descriptions import refitted
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.newton import degrees_of_freedom, squared, stacked
from gtau.estimation.regression.factors import MODEL
from gtau.estimation.regression.priors import file_sums, inertia_priors, sizes_of, stated_inertias
from gtau.estimation.regression.problem import Estimates
from gtau.findings import Finding
from gtau.robots.parameter import Parameter, unit_of
from gtau.robots.robot import INERTIAL

INERTIA_CHANCE = 0.05  # chance that a correct file has any base parameter contradicted, all tests together
FILE_WORSE = 1.1  # torque error by the file over the error by the data, from which links are named
INERTIA_EXPLAINED = 0.95  # share of the torque variance added by the file: links that explain it suffice
ROUNDING = 1e-9  # of a column of unit norm: less is rounding

ROTORS, PRIOR_INERTIA = "the rotor inertias", "contradictory inertias of the robot's file"
Standing = Literal["agrees", "contradicted", "not identifiable", "not stated"]


@dataclass(frozen=True)
class AuditedParameter:
    """A base parameter by the file and from the data; its ``link`` is the body of its first standard parameter.

    It is not identifiable where its 95 % ``interval`` is wider than +-100 % of what the file's link weighs there (m,
    m r or m r^2), or there is none; not stated where it regroups a rotor inertia that the file does not state.
    ``stated`` is what the file's parameters add up to, ``value`` and ``std`` are from the data alone, and ``z`` is the
    difference over its standard deviation, which includes the prior's where the file was one.
    """

    name: str
    link: str
    unit: str
    standing: Standing
    stated: float | None
    value: float | None = None
    std: float | None = None
    interval: tuple[float, float] | None = None
    z: float | None = None


@dataclass(frozen=True)
class AuditedLink:
    """A link, or all rotors: with its parameters freed, and those before it, the file's torque error is ``error``.

    That is the rms over the joints of their relative torque errors, per cent.
    """

    name: str
    error: float


@dataclass(frozen=True)
class InertiaAudit:
    """Comparison of the robot file's inertias with the data.

    ``stated`` and ``identified`` are the torque errors of each joint with the file's inertias and with the identified
    ones, per cent of its rms torque, over the rows used; ``parameters`` all base parameters that regroup inertias.
    ``links`` explain why the file predicts worse, the first explains most; none where it hardly does, or agrees.
    ``prior`` is the relative standard deviation of the file's inertias where they were priors, else 0.
    """

    stated: Mapping[str, float]
    identified: Mapping[str, float]
    parameters: tuple[AuditedParameter, ...]
    links: tuple[AuditedLink, ...]
    prior: float = 0.0

    @property
    def stated_error(self) -> float:
        """Rms over the joints of ``stated``, per cent."""
        return _rms(self.stated)

    @property
    def identified_error(self) -> float:
        """Rms over the joints of ``identified``, per cent."""
        return _rms(self.identified)

    def of(self, standing: Standing) -> tuple[AuditedParameter, ...]:
        """Return the parameters of this standing."""
        return tuple(parameter for parameter in self.parameters if parameter.standing == standing)

    def contradicted_priors(self) -> Iterator[Finding]:
        """Find the links whose inertias in the file, taken as priors, the data contradict."""
        contradicted = self.of("contradicted") if self.prior else ()
        for link in dict.fromkeys(entry.link for entry in contradicted):
            entries = [entry for entry in contradicted if entry.link == link]
            named = "; ".join(
                f"{entry.name} is {entry.value:.3g} {entry.unit} from the data (standard deviation {entry.std:.2g}), "
                f"{entry.stated:.3g} in the file"
                for entry in entries[:3]
            )
            more = f" and {len(entries) - 3} more" if len(entries) > 3 else ""
            yield Finding(
                PRIOR_INERTIA,
                subject=link,
                # in halves of an interval; z has the prior of the regrouped sum, here the parameter's own counts
                size=max(
                    abs(entry.value - entry.stated) / (1.96 * np.hypot(entry.std, self.prior * entry.stated))
                    for entry in entries
                    if entry.value is not None and entry.std is not None and entry.stated is not None
                ),
                text=f"the inertias of '{link}' in the robot file, used as priors with a standard deviation of "
                f"{100 * self.prior:.0f} %, contradict the data: {named}{more}",
                advice="give 'prior_inertias' a larger value, or correct the file",
                shown_as="model",
            )


def _rms(errors: Mapping[str, float]) -> float:
    return float(np.sqrt(np.mean(np.square(list(errors.values())))))


def audit_inertias(fit: Fit, estimates: Estimates, loaded: bool) -> tuple[Fit | None, InertiaAudit | None]:
    """Compare the robot file's inertias with a fit without them, which is returned too.

    That is refitted where the file's inertias were priors, None where then nothing gives the scale; they are compared
    with the fit that has them, and the audit is returned if it contradicts some even so. A robot that is ``loaded``
    with a body that is not declared is not audited: the file is not blamed for what it lacks.
    """
    bare: Fit | None = fit
    covariance = estimates.covariance
    freedom = estimates.effective_freedom
    prior = fit.dataset.prior_inertias
    if prior:
        dataset = replace(fit.dataset, priors=fit.dataset.stated_priors, prior_inertias=0.0)
        bare = refitted(fit, dataset=dataset)
        if bare is not None:
            freedom = degrees_of_freedom(bare.system.problem, bare.solution, fit.free_gains)
            fit, covariance = bare, bare.solution.jackknife
    if loaded:
        return bare, None
    identified = fit.system.full(fit.solution.theta)[:-1]
    file, tested, unstated = _file_values(fit, identified)
    prior_values = _kept(fit, file, prior)
    std = np.sqrt(np.diag(covariance))
    parameters = _parameters(fit, file, tested, unstated, prior_values, std, freedom)
    wrong = any(parameter.standing == "contradicted" for parameter in parameters)
    if bare is None and not wrong:
        return None, None
    by_file, by_data = _errors(fit, file), _errors(fit, identified)
    worse = _rms(by_file) > FILE_WORSE * _rms(by_data)
    links = tuple(_links(fit, identified, file)) if wrong and worse else ()
    return bare, InertiaAudit(by_file, by_data, parameters, links, prior)


def _file_values(fit: Fit, identified: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Replace parameters of the whole problem (n_whole,) by the file's, with masks (n_b,) of base parameters.

    The first mask holds the parameters that regroup inertias alone, the second those among them that regroup a rotor
    inertia which the file does not state.
    """
    base, names = fit.dataset.base, fit.dataset.model.parameter_names
    values, inertial, unknown = file_sums(fit.dataset.model, base)
    rotors = [name.kind == "ia" and name not in stated_inertias(fit.dataset.robot) for name in names]
    raised = np.all(base.matrix[:, rotors] >= 0, axis=1)
    fitted = identified[: base.count]
    values = np.where(inertial, values, fitted)
    values = np.where(unknown, np.where(raised, np.maximum(values, fitted), fitted), values)
    return np.append(values, identified[base.count :]), inertial, unknown


def _errors(fit: Fit, theta: np.ndarray) -> dict[str, float]:
    """Compute the torque errors of the joints, per cent of their rms torque."""
    problem, solution = fit.system.unreduced, fit.solution
    squares = squared(stacked(problem), np.concatenate([theta, solution.gains, solution.delays]))
    rms = np.sqrt(squares / problem.total_rows)
    return dict(zip(problem.joints, (100 * rms / problem.balance(theta)).tolist(), strict=False))


def _rows(fit: Fit) -> np.ndarray:
    """Compute the weighted Jacobian of the residuals by the whole problem's parameters, (., n_whole)."""
    problem, solution = fit.system.unreduced, fit.solution
    weights = 1 / (solution.gains * np.maximum(solution.sigma, problem.smallest_sigma))
    return np.concatenate([w * R[:, MODEL] for w, R in zip(weights, problem.triangles, strict=True)])


def _kept(fit: Fit, file: np.ndarray, prior: float) -> dict[Parameter, tuple[float, float]]:
    """Compute the file's values of the parameters that stay, and their standard deviations as priors.

    What the motions do not separate adds to the parameters that stay: the same sums of the file's.
    """
    base, kept, rows = fit.dataset.base, fit.problem.parameters, _rows(fit)
    places = fit.system.unreduced.unknowns.at(kept)
    scale = np.maximum(np.linalg.norm(rows, axis=0), 1e-300)
    T = np.linalg.lstsq(rows[:, places] / scale[places], rows / scale, rcond=None)[0]
    T = np.where(np.abs(T) > ROUNDING, T, 0.0) * scale / scale[places][:, None]
    stds = inertia_priors(fit.dataset.robot, prior) if prior else {}
    sigma = np.array([stds[name].std if name in stds else 0.0 for name in fit.dataset.model.parameter_names])
    prior_stds = np.linalg.norm(T[:, : base.count] @ base.matrix * sigma, axis=1)
    return dict(zip(kept, zip((T @ file).tolist(), prior_stds.tolist(), strict=True), strict=True))


def _parameters(
    fit: Fit,
    file: np.ndarray,
    inertial: np.ndarray,
    unstated: np.ndarray,
    kept: Mapping[Parameter, tuple[float, float]],
    stds: np.ndarray,
    freedom: np.ndarray | None,
) -> tuple[AuditedParameter, ...]:
    """Compare each base parameter that regroups inertias."""
    from scipy.special import stdtrit

    base, robot, places = fit.dataset.base, fit.dataset.robot, fit.problem.unknowns.places
    stated = stated_inertias(robot)
    fitted = (base.matrix @ [stated.get(name, 0.0) for name in fit.dataset.model.parameter_names]).tolist()
    tested: dict[Parameter, float] = {}
    audited: dict[Parameter, AuditedParameter] = {}
    for k in np.flatnonzero(inertial).tolist():
        name, kind, body = base.names[k], base.standard[k].kind, base.standard[k].body
        entry = AuditedParameter(name, body, unit_of(kind, robot, body), "not identifiable", float(file[k]))
        if name in kept:
            place, (stated_sum, prior_std) = places[name], kept[name]
            value, std = float(fit.solution.theta[place]), float(stds[place])
            nu = np.inf if freedom is None else float(freedom[place])
            half = std * float(stdtrit(nu, 0.975))
            entry = replace(entry, stated=stated_sum, value=value, std=std, interval=(value - half, value + half))
            sizes = sizes_of(stated, body) if Parameter("m", body) in stated else None
            size = abs(stated_sum) if kind == "ia" else (sizes or {}).get(kind, 0.0)
            if unstated[k]:
                entry = replace(entry, standing="not stated", stated=fitted[k] if kind in INERTIAL else None)
            elif half <= max(size, abs(stated_sum)):
                entry = replace(entry, z=(value - stated_sum) / float(np.hypot(std, prior_std)))
                tested[name] = nu
        audited[name] = entry
    for name, nu in tested.items():
        limit = float(stdtrit(nu, 1 - INERTIA_CHANCE / (2 * len(tested))))
        standing: Standing = "contradicted" if abs(audited[name].z or 0.0) > limit else "agrees"
        audited[name] = replace(audited[name], standing=standing)
    return tuple(audited.values())


def _links(fit: Fit, identified: np.ndarray, file: np.ndarray) -> Iterator[AuditedLink]:
    """Name the links that explain the larger torque error of the file, one after the other."""
    base = fit.dataset.base
    names = fit.dataset.model.parameter_names
    stated = stated_inertias(fit.dataset.robot)
    rows = _rows(fit)
    torque = rows @ (identified - file)
    members: dict[str, list[int]] = {}
    for k, name in enumerate(names):
        if name.kind in INERTIAL or name in stated:
            members.setdefault(ROTORS if name.kind == "ia" else name.body, []).append(k)
    bodies = {body: base.matrix[:, columns] for body, columns in members.items()}
    # rotor inertias that the file leaves open adapt to any change of links
    freed = base.matrix[:, [name.kind == "ia" and name not in stated for name in names]]
    total = least = float(torque @ torque)
    while bodies and least > (1 - INERTIA_EXPLAINED) * total:
        tried = {body: _freed(rows, torque, np.hstack([freed, columns])) for body, columns in bodies.items()}
        body = min(tried, key=lambda name: tried[name][0])
        least, change = tried[body]
        freed = np.hstack([freed, bodies.pop(body)])
        theta = file.copy()
        theta[: base.count] += change
        yield AuditedLink(body, _rms(_errors(fit, theta)))


def _freed(rows: np.ndarray, torque: np.ndarray, G: np.ndarray) -> tuple[float, np.ndarray]:
    """Fit ``torque`` by changes along ``G`` (n_b, c): the squared residual, and the change (n_b,)."""
    A = rows[:, : len(G)] @ G
    norms = np.linalg.norm(A, axis=0)
    norms[norms == 0] = 1.0
    x = np.linalg.lstsq(A / norms, torque, rcond=1e-9)[0] / norms
    rest = torque - A @ x
    return float(rest @ rest), G @ x
