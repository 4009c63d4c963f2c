"""Digital twins of thermal rigs: simulate, match to recordings, analyse, run beside the rig.

The public names are listed in `__init__.pyi`, one line each. A name is imported when it is first
used, so that `import jaxtwin` itself takes very little time; so is a package, such as
`jaxtwin.control`. Importing changes no setting of JAX.
"""

import importlib
import importlib.util
import warnings

import lazy_loader

__version__ = "0.2.0"

_load, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


# Names that were here before, and where they are now. They go with the next version.
_MOVED = {
    "ControlError": "errors",
    "LinkError": "errors",
    "MatchError": "errors",
    "ObserverError": "errors",
    "ParameterError": "errors",
    "RecordingError": "errors",
    "RigError": "errors",
    "SafetyStop": "errors",
    "SimulationError": "errors",
    "StoreError": "errors",
    "LinearModel": "control.StateSpace",
    "RigDesign": "control",
    "Diagnosis": "diagnosis",
    "Isolability": "diagnosis",
    "DiagnosisDesign": "experiment_design",
    "ExperimentDesign": "experiment_design",
    "Monitored": "monitoring",
    "Forecast": "observers",
    "Observed": "observers",
    "match_innovations": "observers",
    "Netlist": "physics",
    "ThermoelectricModule": "physics",
    "build_netlist": "physics",
    "frame_to_channels": "physics",
    "plate_map": "physics",
    "Health": "prognostics",
    "Refit": "refitting",
    "GlobalSensitivity": "sensitivity_analysis",
    "Sensitivity": "sensitivity_analysis",
    "Run": "simulation",
    "StepperState": "simulation",
    "Sweep": "sweeps",
    "Validation": "validation",
}


def __getattr__(name: str) -> object:
    try:
        return _load(name)
    except AttributeError:
        if name in __all__:  # an error of the module behind it
            raise
    if name in _MOVED:
        package, _, renamed = _MOVED[name].partition(".")
        now = renamed or name
        warnings.warn(
            f"jaxtwin.{name} is now jaxtwin.{package}.{now}", DeprecationWarning, stacklevel=2
        )
        return getattr(importlib.import_module(f"{__name__}.{package}"), now)
    if not name.startswith("_") and importlib.util.find_spec(f"{__name__}.{name}") is not None:
        return importlib.import_module(f"{__name__}.{name}")
    from ._name_suggestions import did_you_mean

    hint = did_you_mean([name], __all__)
    raise AttributeError(f"module 'jaxtwin' has no attribute {name!r}{hint}")
