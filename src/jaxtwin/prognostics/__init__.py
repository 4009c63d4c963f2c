r"""Health: how the parameters of a rig change over sessions, and when one passes a limit.

Each session is matched by itself. What it says of a parameter is its estimate without the prior
(`_assess`). The estimates of the sessions are those of a random-effects model (`_trend`): a
straight line over time, on the scale of the match, with a difference of each session from it whose
spread is learned. `health` gives a `Health` (`_health`): for each parameter the trend with its
standard error, the spread between sessions, and the probability that the trend passes a limit
within a time.
"""

from .._faces import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
