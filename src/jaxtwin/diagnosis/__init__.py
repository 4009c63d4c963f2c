r"""Diagnosis: which fault explains what changed in a rig, since when, and how large it is.

`diagnose` (`_diagnose`) follows a recording with one observer, which takes the rig as healthy. What
a fault would do to its innovations is linear in the fault's multiple (`_signatures`), so that one
pass over the innovations gives size and onset of all suspects (`_suspects`) at once, by the
generalised likelihood ratio of Willsky and Jones (`_likelihood_ratio`). The few that explain them
best (`_survivors`) are followed by filters of their own, side by side (`_hypotheses`), which know
the fault's size as a further state. `_causes` goes on so until nothing else has changed. The
result, `Diagnosis` (`_diagnosis`), has the probabilities over time, with two answers that are no
suspects: "healthy", and "none of these" for a change that no suspect explains.

`isolability` (`_isolability`) says the same before the fact: which faults can be seen, which pairs
of them can be told apart, and after what time.
"""

from .._faces import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
