"""The exit codes of all commands, as docs/commands.md lists them."""

FOUND_ERROR = 1
"""A check found an error: a rig file, a device, a fit that is worse than it was published."""

WRONG = 2
"""The command could not do what it was asked to; one line says why."""

TRIPPED = 3
"""An interlock switched the rig off, or `refit` rejected a recording or asks."""

NOT_CONVERGED = 4
"""A match did not converge."""

ALARMED = 5
"""An alarm: somebody should look at the rig."""

STOPPED = 130
"""Stopped by Ctrl-C."""
