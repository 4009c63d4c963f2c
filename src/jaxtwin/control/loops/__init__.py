"""Closed loops: their scenario, the loop of a twin, of many and of a rig, its signals and measures,
and what is checked before a loop runs (`_loop_checks`, `_loop_margins`)."""
