"""Behavioural matching: parameters from recordings."""

from ._levenberg_marquardt import BoundedLevenbergMarquardt, LMState

__all__ = ["BoundedLevenbergMarquardt", "LMState"]
