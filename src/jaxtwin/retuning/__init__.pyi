# Public names of jaxtwin.retuning. `__init__.py` imports each when it is first used.

from ._loop_band import LoopBand as LoopBand
from ._loop_band import LoopWatch as LoopWatch
from ._pairs import Pair as Pair
from ._pairs import keep_retuned as keep_retuned
from ._pairs import pair_of as pair_of
from ._pairs import retune_champion as retune_champion
from ._retune import retune as retune
from ._retuned import Retuned as Retuned
from ._scenarios import TrialScenario as TrialScenario
from ._scenarios import usual_scenarios as usual_scenarios
from ._trial import LoopTrial as LoopTrial
from ._trial import ScenarioTrial as ScenarioTrial
