"""Findings of a monitor that tests raise: an alarm, and what is none."""

from dataclasses import replace

from jaxtwin.live import Finding

ALARM = Finding("sudden", "T1 is 3 K above what is expected", "T1")
NOTICE = replace(ALARM, kind="changed", severity="notice")
