"""The public names of eqsim."""

from eqsim.engine.breaks import Breaks, breaks
from eqsim.engine.elastic import ElasticTrajectory, elastic_trajectory
from eqsim.engine.records import ProgrammeTrajectory, SliderTrajectory, Slip, Trajectory
from eqsim.engine.steady import Steady, steady
from eqsim.engine.trajectory import trajectory
from eqsim.errors import InputError
from eqsim.estimate import OBSERVABLES, Estimate, z_score
from eqsim.fitting.fit import FitResult, fit
from eqsim.fitting.posterior import Posterior, posterior
from eqsim.io.runfile import RunFile, load
from eqsim.laws.aging import Aging
from eqsim.laws.delay import Delay
from eqsim.laws.named import Exponential, Lognormal, Normal, Pareto, Uniform, Weibull
from eqsim.laws.newborn import Newborn
from eqsim.laws.thermal import Thermal
from eqsim.laws.threshold import Delta, Distribution, Gamma, Table
from eqsim.master.closure import Closure, closure
from eqsim.master.stability import FreshSlip, Stability, fresh_slip, stability
from eqsim.master.steady import Curve, Reference, curve, reference
from eqsim.master.transient import Fluctuations, Transient, fluctuations, transient
from eqsim.model.drive import Drive, Programme, Segment, Stage
from eqsim.model.elastic import Elastic
from eqsim.model.ensemble import Ensemble
from eqsim.validation import Validation, validate
from eqsim.workflows.replay import Replay, replay
from eqsim.workflows.run import RunResult, run
from eqsim.workflows.sweep import sweep

__all__ = [
    "OBSERVABLES",
    "Aging",
    "Breaks",
    "Closure",
    "Curve",
    "Delay",
    "Delta",
    "Distribution",
    "Drive",
    "Elastic",
    "ElasticTrajectory",
    "Ensemble",
    "Estimate",
    "Exponential",
    "FitResult",
    "Fluctuations",
    "FreshSlip",
    "Gamma",
    "InputError",
    "Lognormal",
    "Newborn",
    "Normal",
    "Pareto",
    "Posterior",
    "Programme",
    "ProgrammeTrajectory",
    "Reference",
    "Replay",
    "RunFile",
    "RunResult",
    "Segment",
    "SliderTrajectory",
    "Slip",
    "Stability",
    "Stage",
    "Steady",
    "Table",
    "Thermal",
    "Trajectory",
    "Transient",
    "Uniform",
    "Validation",
    "Weibull",
    "breaks",
    "closure",
    "curve",
    "elastic_trajectory",
    "fit",
    "fluctuations",
    "fresh_slip",
    "load",
    "posterior",
    "reference",
    "replay",
    "run",
    "stability",
    "steady",
    "sweep",
    "trajectory",
    "transient",
    "validate",
    "z_score",
]  # fmt: skip
