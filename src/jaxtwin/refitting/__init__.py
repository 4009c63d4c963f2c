"""Refits that can be trusted: a new twin replaces the last one if it passes a gate.

`refit` (`_refit`) takes the last fit and new recordings. The last posterior, with what is forgotten
between sessions (`_forgetting`), is the prior of a match that also finds which values have changed
beyond that (`_session_match`). Mistakes of the recording (`_mistakes`) and errors of its sensors
(`_sensor_errors`) are its rivals. What is held out (`_held_out`) is replayed through both twins,
and the checks of the gate (`_gate`) decide: promoted, unchanged, rejected, or a person is asked.
`keep_refit` writes it into a store of twins.
"""

from .._faces import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
