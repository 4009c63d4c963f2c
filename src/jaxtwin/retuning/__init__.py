"""A controller that is tuned again when its twin has changed, and tried before the rig sees it.

`retune` (`_retune`) tunes the controller by `tune`, over draws of the new posterior, and runs the
candidate beside the present controller through scenarios (`_scenarios`, `_trial`): another room, a
door, a lost sensor, twice the delay, faults. `Retuned` (`_retuned`) is the decision with its
reason. `retune_champion` and `keep_retuned` (`_pairs`) keep twin and controller as a pair in a
store of twins. On the rig, `LoopWatch` (`_loop_band`) compares the loop with what the trial
predicted.
"""

from ._loop_band import LoopBand, LoopWatch
from ._pairs import Pair, keep_retuned, pair_of, retune_champion
from ._retune import retune
from ._retuned import Retuned
from ._scenarios import TrialScenario, usual_scenarios
from ._trial import LoopTrial, ScenarioTrial

__all__ = [
    "LoopBand",
    "LoopTrial",
    "LoopWatch",
    "Pair",
    "Retuned",
    "ScenarioTrial",
    "TrialScenario",
    "keep_retuned",
    "pair_of",
    "retune",
    "retune_champion",
    "usual_scenarios",
]
