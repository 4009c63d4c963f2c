"""The exit codes of all commands, as docs/commands.md lists them."""

# A test of a device found an error: `conform`, `prove`.
FOUND_ERROR = 1

# The command could not do what it was asked to; one line says why.
USAGE_ERROR = 2

# An interlock switched the rig off; `refit` rejected a recording or asks, or `retune` a controller.
TRIPPED = REJECTED = 3

# A match did not converge.
NOT_CONVERGED = 4

# An alarm: somebody should look at the rig. It also stands for an alarm that switched the rig off,
# and for heat that a device reports after a stop.
ALARMED = 5

# The rig heats after it was switched off, as its readings show, or as its device reports in the
# minute after the end: cut the power.
HEATS = 6

# Stopped by Ctrl-C.
STOPPED = 130
