"""The small rigs that other tests have."""

from small_rigs import make_rig as make_rig
