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

from gtau.estimation.diagnostics.alternatives import refitted
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.newton import degrees_of_freedom, squared, stacked
from gtau.estimation.regression.assembly import inertia_priors, sizes_of, stated_inertias
from gtau.estimation.regression.factors import MODEL
from gtau.estimation.thresholds.estimates import INERTIA_CHANCE, INERTIA_EXPLAINED
from gtau.findings import Finding
from gtau.findings import FindingKind as F
from gtau.robots.parameter import Parameter, unit_of
from gtau.robots.robot import DRIVE, INERTIAL

ROTORS = "the rotor inertias"
Standing = Literal["agrees", "contradicted", "not identifiable", "not stated"]


@dataclass(frozen=True)
class AuditedParameter:
    """A base parameter by the file and from the data.

    Attributes
    ----------
    name, link, unit : str
        The link is the body of its first standard parameter.
    standing : {"agrees", "contradicted", "not identifiable", "not stated"}
        Not identifiable where its 95 % interval is wider than +-100 % of what the file's link weighs there (m, m r or
        m r^2), or there is none; not stated where it regroups a rotor inertia that the file does not state.
    stated : float or None
        What the file's parameters add up to; None of a rotor inertia that it does not state.
    value, std : float or None
        From the data alone.
    interval : tuple of float or None
        95 %.
    z : float or None
        Difference from the file over its standard deviation, with that of a prior where the file was one.
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

    Attributes
    ----------
    stated, identified : dict
        Torque error of each joint with the file's inertias and with the identified ones, per cent of its rms torque,
        over the rows used.
    parameters : tuple of AuditedParameter
        All base parameters that regroup inertias.
    links : tuple of AuditedLink
        Links that explain why the file predicts worse, the first explains most; none where nothing is contradicted.
    prior : float
        Relative standard deviation of the file's inertias where they were priors, else 0.
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


def _rms(errors: Mapping[str, float]) -> float:
    return float(np.sqrt(np.mean(np.square(list(errors.values())))))


def without_file_inertias(
    fit: Fit, covariance: np.ndarray, freedom: np.ndarray | None
) -> tuple[Fit, np.ndarray, np.ndarray | None] | None:
    """Refit without the robot file's inertias where they were priors, with covariance and freedom of that fit.

    Those given are returned where the file's inertias were no priors, None where nothing else gives the scale.
    """
    if not fit.dataset.prior_inertias:
        return fit, covariance, freedom
    dataset = replace(fit.dataset, priors=fit.dataset.stated_priors, prior_inertias=0.0)
    bare = refitted(fit, dataset=dataset)
    if bare is None:
        return None
    return bare, bare.solution.jackknife, degrees_of_freedom(bare.system.problem, bare.solution, fit.free_gains)


def audit_inertias(
    fit: Fit, covariance: np.ndarray, freedom: np.ndarray | None, prior: float = 0.0
) -> InertiaAudit | None:
    """Compare the robot file's inertias with a fit without them; None where the file states none.

    ``covariance`` (k, k) and ``freedom`` (k,) are those of the fit, ``prior`` is the relative standard deviation with
    which the file's inertias are taken, 0 where they are taken as written.
    """
    stated = stated_inertias(fit.dataset.robot)
    if not stated:
        return None
    comparison = _Comparison.of(fit, stated)
    parameters = _parameters(comparison, covariance, freedom, prior)
    wrong = any(parameter.standing == "contradicted" for parameter in parameters)
    links = tuple(_links(comparison)) if wrong else ()
    errors = comparison.errors(comparison.file), comparison.errors(comparison.identified)
    return InertiaAudit(*errors, parameters, links, prior)


@dataclass(frozen=True, eq=False)
class _Comparison:
    """Parameters of the whole problem, (n_whole,), as ``identified`` and by the ``file``; which are ``inertial``.

    ``open`` are those that regroup a rotor inertia which the file does not state among the ``stated`` ones.
    """

    fit: Fit
    stated: Mapping[str, float]
    identified: np.ndarray
    file: np.ndarray
    inertial: np.ndarray
    open: np.ndarray

    @classmethod
    def of(cls, fit: Fit, stated: Mapping[str, float]) -> _Comparison:
        base, names = fit.dataset.base, fit.dataset.model.parameter_names
        identified = fit.system.full(fit.solution.theta)[:-1]
        values = np.array([stated.get(name, 0.0) for name in names])
        unstated = np.array([name.kind == "ia" and name not in stated for name in names])
        of_bodies = np.array([name.kind in (*INERTIAL, "ia") for name in names])
        of_drives = np.array([name.kind in DRIVE[1:] for name in names])
        inertial, unknown, raised = (np.zeros(len(identified), dtype=bool) for _ in range(3))
        inertial[: base.count] = np.any(base.matrix[:, of_bodies], axis=1) & ~np.any(base.matrix[:, of_drives], axis=1)
        unknown[: base.count] = np.any(base.matrix[:, unstated], axis=1)
        raised[: base.count] = np.all(base.matrix[:, unstated] >= 0, axis=1)
        file = identified.copy()
        file[: base.count][inertial[: base.count]] = (base.matrix @ values)[inertial[: base.count]]
        file = np.where(unknown & raised, np.maximum(file, identified), np.where(unknown, identified, file))
        return cls(fit, stated, identified, file, inertial, unknown & inertial)

    def errors(self, theta: np.ndarray) -> dict[str, float]:
        """Compute the torque errors of the joints, per cent of their rms torque."""
        whole, solution = self.fit.system.whole, self.fit.solution
        squares = squared(stacked(whole), np.concatenate([theta, solution.gains, solution.delays]))
        rms = np.sqrt(squares / whole.total_rows)
        share = 100 * rms / whole.balance(theta)
        return {joint: float(share[k]) for k, joint in enumerate(whole.joints)}

    @property
    def rows(self) -> np.ndarray:
        """Weighted Jacobian of the residuals with respect to the whole problem's parameters, (., n_whole)."""
        problem, solution = self.fit.system.whole, self.fit.solution
        weights = 1 / (solution.gains * np.maximum(solution.sigma, problem.smallest_sigma))
        return np.concatenate([w * R[:, MODEL] for w, R in zip(weights, problem.triangles, strict=True)])

    def kept(self, prior: float) -> tuple[np.ndarray, np.ndarray]:
        """Compute the file's values of the parameters that stay (n_theta,), and their standard deviations as priors.

        What the motions do not separate adds to the parameters that stay: the same sums of the file's.
        """
        base, robot, names = self.fit.dataset.base, self.fit.dataset.robot, self.fit.dataset.model.parameter_names
        places = [self.fit.system.whole.parameters.index(name) for name in self.fit.system.problem.parameters]
        rows = self.rows
        scale = np.maximum(np.linalg.norm(rows, axis=0), 1e-300)
        T = np.linalg.lstsq(rows[:, places] / scale[places], rows / scale, rcond=None)[0]
        T = T * scale / scale[places][:, None]
        stds = inertia_priors(robot, prior) if prior else {}
        sigma = np.array([(stds[name].std or 0.0) if name in stds else 0.0 for name in names])
        return T @ self.file, np.sqrt(np.sum((T[:, : base.count] @ base.matrix * sigma) ** 2, axis=1))


def _parameters(
    comparison: _Comparison, covariance: np.ndarray, freedom: np.ndarray | None, prior: float
) -> tuple[AuditedParameter, ...]:
    """Compare each base parameter that regroups inertias."""
    from scipy.special import stdtrit

    fit, stated, base = comparison.fit, comparison.stated, comparison.fit.dataset.base
    kept, (file, prior_std) = fit.system.problem.parameters, comparison.kept(prior)
    own = (base.matrix @ [stated.get(name, 0.0) for name in fit.dataset.model.parameter_names]).tolist()
    tested: dict[Parameter, float] = {}
    audited: dict[Parameter, AuditedParameter] = {}
    for k, name in enumerate(base.names):
        if not comparison.inertial[k]:
            continue
        kind, body = base.standard[k].kind, base.standard[k].body
        unit = unit_of(kind, fit.dataset.robot, body)
        audited[name] = AuditedParameter(name, body, unit, "not identifiable", float(comparison.file[k]))
        if name not in kept:
            continue
        place = kept.index(name)
        value, std, of_file = float(fit.solution.theta[place]), float(np.sqrt(covariance[place, place])), file[place]
        nu = np.inf if freedom is None else float(freedom[place])
        half = std * float(stdtrit(nu, 0.975))
        interval = value - half, value + half
        audited[name] = replace(audited[name], stated=float(of_file), value=value, std=std, interval=interval)
        sizes = sizes_of(dict(stated), body) if Parameter("m", body) in stated else None
        size = abs(of_file) if kind == "ia" else (sizes or {}).get(kind, 0.0)
        if comparison.open[k]:
            of_file = own[k] if kind in INERTIAL else None
            audited[name] = replace(audited[name], standing="not stated", stated=of_file)
        elif half <= max(size, abs(of_file)):
            z = (value - float(of_file)) / float(np.hypot(std, prior_std[place]))
            audited[name], tested[name] = replace(audited[name], z=z), nu
    for name, nu in tested.items():
        limit = float(stdtrit(nu, 1 - INERTIA_CHANCE / (2 * len(tested))))
        standing: Standing = "contradicted" if abs(audited[name].z or 0.0) > limit else "agrees"
        audited[name] = replace(audited[name], standing=standing)
    return tuple(audited.values())


def _links(comparison: _Comparison) -> Iterator[AuditedLink]:
    """Name the links that explain the larger torque error of the file, one after the other."""
    base, names = comparison.fit.dataset.base, comparison.fit.dataset.model.parameter_names
    rows, stated = comparison.rows, comparison.stated
    torque = rows @ (comparison.identified - comparison.file)
    members: dict[str, list[int]] = {}
    for k, name in enumerate(names):
        if name.kind in INERTIAL or name in stated:
            members.setdefault(ROTORS if name.kind == "ia" else name.body, []).append(k)
    bodies = {body: base.matrix[:, columns] for body, columns in members.items()}
    # rotor inertias that the file leaves open adapt to any change of links
    freed = base.matrix[:, [k for k, name in enumerate(names) if name.kind == "ia" and name not in stated]]
    least, total = float(torque @ torque), float(torque @ torque)
    while bodies and least > (1 - INERTIA_EXPLAINED) * total:
        tried = {body: _freed(rows, torque, np.hstack([freed, columns])) for body, columns in bodies.items()}
        body = min(tried, key=lambda name: tried[name][0])
        least, change = tried[body]
        freed = np.hstack([freed, bodies.pop(body)])
        theta = comparison.file.copy()
        theta[: base.count] += change
        yield AuditedLink(body, _rms(comparison.errors(theta)))


def _freed(rows: np.ndarray, torque: np.ndarray, G: np.ndarray) -> tuple[float, np.ndarray]:
    """Fit ``torque`` by changes along ``G`` (n_b, c): the squared residual, and the change (n_b,)."""
    A = rows[:, : len(G)] @ G
    norms = np.linalg.norm(A, axis=0)
    norms[norms == 0] = 1.0
    x = np.linalg.lstsq(A / norms, torque, rcond=1e-9)[0] / norms
    rest = torque - A @ x
    return float(rest @ rest), G @ x


def prior_findings(audit: InertiaAudit | None) -> list[Finding]:
    """Find the links whose inertias in the file, taken as priors, the data contradict."""
    if audit is None or not audit.prior:
        return []
    wrong = audit.of("contradicted")
    listed = {
        link: [[entry.name, entry.value, entry.std, entry.stated, entry.unit] for entry in wrong if entry.link == link]
        for link in dict.fromkeys(entry.link for entry in wrong)
    }
    return [
        Finding(F.PRIOR_INERTIA, (), link, {"std": audit.prior, "parameters": parameters})
        for link, parameters in listed.items()
    ]
