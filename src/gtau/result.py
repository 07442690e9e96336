"""What users hold: a result with its methods, and the call that makes it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any
from warnings import warn

import numpy as np

from gtau.documents.validation import FUNCTION, MASSES, NUMBER, PATH, TEXT, TRUTH, takes
from gtau.errors import UnknownName, spelled
from gtau.estimation import check_logs
from gtau.estimation.experiment_runs import ACCURACY, options_of
from gtau.estimation.identify import EstimatorComparison, compare as compare_estimators
from gtau.estimation.results import model_file
from gtau.estimation.results.estimate import Estimate, TorqueError
from gtau.estimation.results.result import IdentifiedModel, estimates_frame
from gtau.findings import Progress, silent
from gtau.robots.readers.read import frame_on
from gtau.robots.robot import Robot
from gtau.signals.reading.experiment import Experiment
from gtau.signals.reading.statements import Payload, Prior, as_payload
from gtau.signals.run import Run
from gtau.uses import identified, identify as uses
from gtau.uses.identify import described, in_python, python_words
from gtau.uses.prediction import Prediction, predict, torque_errors, torques

if TYPE_CHECKING:
    import polars as pl

    from gtau.export.exported import Exported
    from gtau.report.plots import Plots
    from gtau.uses.external_torques import TorquesAlongLog

OF_ALL = {"progress": FUNCTION, "prior_inertias": NUMBER, "robot": PATH, "payload": MASSES}


@spelled(
    **dict.fromkeys(("rnea", "rne"), "result.torques(q, qd, qdd)"),
    **dict.fromkeys(("crba", "mass_matrix"), "result.inertia(q)"),
    gravload="result.gravity(q)",
    joints="result.robot.actuated",
    findings="result.notes",
    weigh="gtau.weigh(result, source)",
    fit="gtau.identify(source)",
    verdict="result.drive_gains[joint].verdict",
    **dict.fromkeys(("to_dict", "to_json", "to_dataframe", "df"), "result.to_frame() or result.save(path)"),
)
class Result(IdentifiedModel):
    """An identified model, with what is done with it: predict, validate, plot, report, save."""

    @classmethod
    def of(cls, model: IdentifiedModel) -> Result:
        """Give an identified model the methods of this class."""
        made = object.__new__(cls)
        vars(made).update(vars(model))  # with what is computed already
        return made

    def summary(self, verbose: bool = True) -> str:
        """Summarise the result as text: one screen, or with ``verbose`` all of it."""
        from gtau.report.identification import text

        return text(self, verbose)

    def torques(
        self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray, payload: Payload | Mapping[str, Any] | None = None
    ) -> np.ndarray:
        """Compute torques of the identified model at given states, including all its friction.

        Parameters
        ----------
        q, qd, qdd : ndarray
            Positions, velocities and accelerations (N, n) of the actuated joints, or (n,) of one state, SI units. The
            samples are taken as points of a path that starts at home.
        payload : mapping, optional
            As in an experiment file: ``{"name": "steel"}`` for one that was identified, or with its ``mass``, ...

        Returns
        -------
        ndarray
            (N, n) or (n,), N m or N.

        Raises
        ------
        GtauError
            Where the loops cannot be closed, a pose is too close to a singularity, or the payload's mass is unknown.
        """
        return np.asarray(torques(self, q, qd, qdd, as_payload(payload)))

    def currents(
        self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray, payload: Payload | Mapping[str, Any] | None = None
    ) -> np.ndarray:
        """Compute the currents (N, n), A, for the torques of :meth:`torques`: ``v = tau / g_tau``.

        Delays are not applied: the current reference leads the motion by ``delays``. From logs of torques, whose gains
        are 1, they are these torques, and so are the rows of a floating base.
        """
        return self.torques(q, qd, qdd, payload) / self.gains

    def gravity(self, q: np.ndarray, payload: Payload | Mapping[str, Any] | None = None) -> np.ndarray:
        """Compute the torques of gravity and springs g(q), (N, n) in N m or N, at positions (N, n); or (n,) of one.

        With :meth:`inertia`, :meth:`coriolis` and friction these are the torques of :meth:`torques`:
        ``M(q) qdd + C(q, qd) qd + g(q)`` + friction, offsets and damping. Raises GtauError as that method does.
        """
        return np.asarray(identified.gravity(self, q, as_payload(payload)))

    def inertia(self, q: np.ndarray, payload: Payload | Mapping[str, Any] | None = None) -> np.ndarray:
        """Compute the inertia matrix M(q), (N, n, n) in kg m2 (kg m or kg where joints slide), rotors included."""
        return np.asarray(identified.inertia(self, q, as_payload(payload)))

    def coriolis(self, q: np.ndarray, qd: np.ndarray, payload: Payload | Mapping[str, Any] | None = None) -> np.ndarray:
        """Compute the Coriolis matrix C(q, qd), (N, n, n), by Christoffel's symbols: dM/dt - 2 C is skew-symmetric."""
        return np.asarray(identified.coriolis(self, q, qd, as_payload(payload)))

    def predict(self, run: Run | str | Path) -> Prediction:
        """Predict torques along a run, or the path of a log like the model's, beside the measured ``v g_tau``.

        A path stands for the run with the payload whose mass the log's name gives, as in ``gtau validate``, or none.
        The prediction's ``notes``, which are also warnings, say what is assumed of the payload. Raises GtauError where
        the log does not suit.
        """
        return _warned(predict(self, run))

    def external_torques(
        self,
        run: Run,
        frame: str | None = None,
        force_only: bool = False,
        observer: float | None = None,
        robot: str | Path | None = None,
    ) -> TorquesAlongLog:
        """Compute what the environment exerts on the joints along a run, N m or N, as ``gtau use`` does.

        With a ``frame``, also the force and moment there: ``"x y z roll pitch yaw"`` (m, rad) from the frame of the
        body that carries the payload, or a link of the URDF ``robot``. With an ``observer`` bandwidth, Hz, also the
        estimate of :func:`gtau.momentum_observer`.
        """
        from gtau.uses.external_torques import torques_along_log

        with python_words():
            at = None if frame is None else frame_on(self.robot.tool, frame, robot)
        return _warned(torques_along_log(self, run, at, force_only, observer))

    def validate(self, run: Run | str | Path) -> tuple[TorqueError, ...]:
        """Compute torque errors of each joint on a run or log: of the raw torque, by frequency, and in the fit's band.

        Takes and raises what :meth:`predict` does, and warns as it does.
        """
        return torque_errors(_warned(predict(self, run)), self.robot, self.preparation.bandwidth)

    @property
    def plot(self) -> Plots:
        """Plot the result, one figure per call: ``result.plot.torques("elbow_joint")``."""
        from gtau.report.plots import Plots

        return Plots(self)

    def report(self, path: str | Path) -> None:
        """Write the report of the result and its runs as one self-contained HTML file."""
        from gtau.report.plots import write

        write(self, Path(path))

    __iter__ = None  # by __getitem__ it would ask for the estimate 0

    def __getitem__(self, name: str) -> Estimate:
        """Refuse: an estimate is in its group."""
        for group in ("drive_gains", "parameters", "friction", "motors"):
            if name in getattr(self, group):
                raise UnknownName(f"estimates are in groups; did you mean result.{group}[{str(name)!r}]?")
        raise UnknownName(f"there is no estimate '{name}'; result.to_frame() lists all.")

    def to_frame(self) -> pl.DataFrame:
        """Return all estimates as a Polars table, one row per estimate.

        ``pandas.DataFrame(result.to_frame().to_dict(as_series=False))`` is the same table in pandas.
        """
        return estimates_frame(self)

    def _repr_html_(self) -> str:
        from gtau.report.plots import html

        return html(self)

    def save(self, path: str | Path) -> None:
        """Write the result as JSON, atomically: the ``model.json`` that :func:`gtau.load` and the commands read."""
        model_file.save(self, path)

    @python_words()
    def export(self, kind: str, out: str | Path = "exported", **options: Any) -> Exported:
        """Export the result to a folder, as :func:`gtau.export_model` does."""
        from gtau.export.exported import export_model

        return export_model(self, kind, out, **options)

    @classmethod
    def load(cls, path: str | Path) -> Result:
        """Load a result, as :func:`gtau.load` does."""
        return load(path)


def _warned(made: Any) -> Any:
    """Warn the caller of a public method of what is assumed."""
    for note in made.notes:
        warn(f"{note}.", stacklevel=3)
    return made


@takes(path=PATH)
def load(path: str | Path) -> Result:
    """Load a result that :meth:`Result.save` or ``gtau identify`` wrote.

    Parameters
    ----------
    path : path
        Such as ``result/model.json``.

    Returns
    -------
    Result
        Without the runs, which the file does not hold.

    Raises
    ------
    GtauError
        The file does not exist, or is no result.

    Examples
    --------
    >>> gtau.load("result/model.json").drive_gains["left"].unit
    'N m/A'
    """
    return Result.of(model_file.load(path))


@python_words()
@takes(method=TEXT, ratio=NUMBER, as_paper=TRUTH, consistent=TRUTH, accuracy=NUMBER, **OF_ALL)
def identify(
    source: str | Path | Experiment | Robot | Sequence[str | Path],
    runs: Sequence[Run] | None = None,
    method: str | None = None,
    prior_gains: Mapping[str, float] | None = None,
    ratio: float | None = None,
    as_paper: bool = False,
    consistent: bool = False,
    priors: Mapping[str, Prior | Mapping[str, Any]] | None = None,
    accuracy: float = ACCURACY,
    progress: Progress | None = None,
    prior_inertias: float | None = None,
    robot: str | Path | None = None,
    payload: Mapping[str, float] | None = None,
) -> Result:
    """Identify drive gains and dynamic parameters.

    Parameters
    ----------
    source : path, Experiment, Robot or sequence of path
        An experiment file or the experiment read from it; or a robot, together with ``runs``; or logs, from which an
        experiment is drafted as by :func:`gtau.draft`: the notes of the result list what is guessed.
    runs : sequence of Run, optional
        From :func:`gtau.read_run`; only with a robot.
    method : str, optional
        ``"ml"``, ``"huber"``, ``"iv"``, ``"didim"``, ``"2sls"``, ``"tls"``, ``"wls"`` or ``"ols"``; ``gtau docs
        verdicts`` says when to choose which. If left out, maximum likelihood, or least squares with given gains where
        logs hold torques and nothing tests their scale; with ``as_paper`` the paper's total least squares, "wls" of
        torques.
    prior_gains : mapping, optional
        Joint to gain, N m/A or N per A, of torques the factor that makes them true; the experiment file's if left out.
    ratio : float, optional
        The paper's r_sigma for the essential parameters; if left out, the Bayesian information criterion decides
        which base parameters are cancelled.
    as_paper : bool
        Follow the paper step by step: its TLS (or WLS or OLS), its decimation filter, its friction, no delays,
        standard errors by formula, and the essential parameters re-estimated together with the gains at ratio 10.
        (Samples near reversals are left out all the same: with them TLS fails.)
    consistent : bool
        Also find standard parameters that rigid bodies can have.
    priors : mapping, optional
        Priors on standard and base parameters, by name, as :class:`gtau.Prior` or as a mapping like in
        the experiment file (``{"value": 1.2, "std": 0.4}``); the experiment file's if left out.
    accuracy : float
        Half the relative width of the 95 % interval up to which a gain is good, 0.03 for 3 %.
    progress : callable, optional
        Called as the work goes on.
    prior_inertias : float, optional
        Take the inertias of the robot's file (URDF or MJCF) as priors with this relative standard deviation, 0.3 for
        30 %; the experiment file's if left out. Where nothing else gives the scale of the gains, they give it, and
        that alone.
    robot : path, optional
        With logs: a name of the catalog or the path of a robot's file.
    payload : mapping, optional
        With logs: log to mass of its payload, kg, 0 for none.

    Returns
    -------
    Result
        Drive gains, parameters, payloads and verdicts; ``print(result.summary())`` shows them.

    Raises
    ------
    GtauError
        If a file is wrong, the data cannot be used, or they lack an input of the method.

    Examples
    --------
    >>> result = gtau.identify(["empty_1.csv", "loaded_1200g.csv"], robot="five-bar")
    >>> print(f"{result.drive_gains['left']:.1f}")
    2.6
    """
    asked = {"method": method, "as_paper": as_paper, "consistent": consistent, "accuracy": accuracy, "ratio": ratio}
    options = options_of(prior_gains, priors, prior_inertias=prior_inertias, **asked)
    subject = described(source, runs, robot, payload, "identify")
    return Result.of(uses.identify(subject, runs, options, progress or silent))


class ExperimentCheck(check_logs.CheckedExperiment):
    """What :func:`check` finds: the readable logs, their preparation, and ``notes`` on all findings."""

    def summary(self) -> str:
        """Summarise the check as text, as ``gtau check`` prints it."""
        from gtau.report.logs import check_page
        from gtau.report.terminal import plain

        return plain(check_page(self))


@python_words()
@takes(method=TEXT, **OF_ALL)
def check(
    source: str | Path | Experiment | Robot | Sequence[str | Path],
    runs: Sequence[Run] | None = None,
    method: str | None = None,
    prior_gains: Mapping[str, float] | None = None,
    priors: Mapping[str, Prior | Mapping[str, Any]] | None = None,
    progress: Progress | None = None,
    prior_inertias: float | None = None,
    robot: str | Path | None = None,
    payload: Mapping[str, float] | None = None,
) -> ExperimentCheck:
    """Check the logs of an experiment: find everything that an identification would refuse, repair or report.

    It takes what :func:`gtau.identify` takes. A log that cannot be used does not keep the others from being checked.
    ``method`` is the estimator of the identification; its default if left out.

    Raises
    ------
    GtauError
        Where the experiment file or the robot's file is wrong.

    Examples
    --------
    >>> print(gtau.check(["empty_1.csv", "loaded_1200g.csv"], robot="five-bar").worst.value)
    information
    """
    options = options_of(prior_gains, priors, method=method, prior_inertias=prior_inertias)
    subject = described(source, runs, robot, payload, "check")
    checked = check_logs.check(subject, runs, options, progress or silent)
    guesses = subject.guesses if isinstance(subject, Experiment) else ()
    notes = [replace(note, text=in_python(note.text), advice=in_python(note.advice)) for note in checked.notes]
    return ExperimentCheck(**{**vars(checked), "notes": (*notes, *guesses)})


@python_words()
@takes(**OF_ALL)
def compare(
    source: str | Path | Experiment | Robot | Sequence[str | Path],
    runs: Sequence[Run] | None = None,
    prior_gains: Mapping[str, float] | None = None,
    priors: Mapping[str, Prior | Mapping[str, Any]] | None = None,
    progress: Progress | None = None,
    prior_inertias: float | None = None,
    robot: str | Path | None = None,
    payload: Mapping[str, float] | None = None,
) -> EstimatorComparison:
    """Identify with every estimator, with the arguments of :func:`gtau.identify`, and compare the results.

    Raises
    ------
    GtauError
        Where a file is wrong, or the runs cannot fix the scale of the gains.

    Examples
    --------
    >>> [row.method for row in gtau.compare("experiment.yaml").rows if row.gains is not None]
    ['ml', 'huber', 'iv', 'didim', '2sls', 'tls']
    """
    options = options_of(prior_gains, priors, prior_inertias=prior_inertias)
    return compare_estimators(described(source, runs, robot, payload, "compare"), runs, options, progress or silent)
