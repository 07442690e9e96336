from .campaigns.campaign import CampaignState as CampaignState, campaign as campaign
from .errors import GtauError as GtauError
from .estimation.identify import EstimatorComparison as EstimatorComparison
from .estimation.results.estimate import Estimate as Estimate, TorqueError as TorqueError
from .estimation.results.payload_body import PayloadBody as PayloadBody, PayloadEstimate as PayloadEstimate
from .estimation.results.result import IdentifiedModel as IdentifiedModel
from .excitation.design import Design as Design, excite as excite
from .excitation.design_file import read_design as read_design
from .excitation.task import DesignProblem as DesignProblem
from .export.exported import Exported as Exported, export_model as export_model
from .export.payload import export_payload as export_payload
from .fleets.fleet import fleet as fleet
from .fleets.table import FleetTable as FleetTable
from .model.base_parameters import BaseParameters as BaseParameters, base_parameters as base_parameters
from .model.home import load_robot as load_robot
from .model.inverse_dynamics import InverseDynamics as InverseDynamics
from .report.plots import plot as plot
from .result import (
    ExperimentCheck as ExperimentCheck,
    Result as Result,
    check as check,
    compare as compare,
    identify as identify,
    load as load,
)
from .robots.readers.source import RobotSource as RobotSource
from .robots.robot import Robot as Robot
from .signals.reading.columns import Signals as Signals
from .signals.reading.experiment import Experiment as Experiment, read_experiment as read_experiment
from .signals.reading.samples import Part as Part
from .signals.reading.statements import Payload as Payload, PreparationSettings as PreparationSettings, Prior as Prior
from .signals.reading.units import Units as Units
from .signals.run import Run as Run, read_run as read_run
from .simulation.simulate import Simulation as Simulation, simulate as simulate
from .uses.external_torques import momentum_observer as momentum_observer
from .uses.identify import draft as draft
from .uses.prediction import Prediction as Prediction
from .uses.weigh import weigh as weigh
from .watch.watch import Watch as Watch

__version__: str
