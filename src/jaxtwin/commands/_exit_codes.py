"""The exit codes of all commands, as docs/commands.md lists them."""

FOUND_ERROR = 1
"""A test of a device found an error: `conform`, `prove`."""

WRONG = 2
"""The command could not do what it was asked to; one line says why."""

TRIPPED = REJECTED = 3
"""An interlock switched the rig off; `refit` rejected a recording or asks."""

NOT_CONVERGED = 4
"""A match did not converge."""

ALARMED = 5
"""An alarm: somebody should look at the rig. It also stands for an alarm that switched the rig off,
and for heat that a device reports after a stop."""

HEATS = 6
"""The rig heats after it was switched off, as its readings show, or as its device reports in the
minute after the end: cut the power."""

STOPPED = 130
"""Stopped by Ctrl-C."""
