"""The exceptions of jaxtwin.

Each message names the file, if there is one, and the field or line. It has the form "expected ...,
got ...", and ends with what to do if that is not obvious. Catch `JaxtwinError` to catch all of
them.
"""


class JaxtwinError(Exception):
    """The base class of all errors that jaxtwin raises on bad input."""


class RigError(JaxtwinError):
    """A rig file or a rig that cannot be built: unknown keys, wrong units, impossible geometry."""


class RecordingError(JaxtwinError):
    """A recording that cannot be read, or whose samples break the rules of an experiment."""


class ParameterError(JaxtwinError):
    """A parameter that is unknown, outside its bounds, or not a finite number."""


class SimulationError(JaxtwinError):
    """A simulation that was set up wrongly or did not reach its end."""


class MatchError(JaxtwinError):
    """A match that cannot be started, such as one without a free parameter."""


class ControlError(JaxtwinError):
    """A linear model, a controller or a closed loop that cannot be made from its arguments."""


class ObserverError(JaxtwinError):
    """An observer that cannot be made for a rig, or readings that it cannot take."""


class StoreError(JaxtwinError):
    """A store of twins that cannot be read or written, or that lacks a version."""


class LinkError(JaxtwinError):
    """A link that cannot be opened, or a peer that does not use the protocol or is another rig."""


class SafetyStop(JaxtwinError):  # noqa: N818 (a decision, not a mistake)
    """Driving was stopped and the cells were switched off: a limit was passed or the link lost.

    `kind` is the reason in one word, for programs: the kind of the interlock that tripped, or
    `not-ready`.
    """

    def __init__(self, message: str, kind: str = "not-ready"):
        super().__init__(message)
        self.kind = kind
