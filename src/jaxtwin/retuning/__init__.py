"""A controller that is tuned again when its twin has changed, and tried before the rig sees it.

`retune` (`_retune`) tunes the controller by `tune`, over draws of the new posterior, and runs the
candidate beside the present controller through scenarios (`_scenarios`, `_trial`): another room, a
door, a lost sensor, twice the delay, faults. `Retuned` (`_retuned`) is the decision with its
reason. `retune_champion` and `keep_retuned` (`_pairs`) keep twin and controller as a pair in a
store of twins. On the rig, `LoopWatch` (`_loop_band`) compares the loop with what the trial
predicted.
"""

from .._faces import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
