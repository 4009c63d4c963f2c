"""A fleet of rigs, watched from the topics of a broker: `jaxtwin fleet`.

A file (`_fleet_file`) names the broker and groups of rigs. `Fleet` (`_fleet`) is one loop in the
main thread. `Inbox` (`_inbox`) reads the messages that rigs publish as `jaxtwin record --publish`
does, `Journal` (`_journal`) keeps them before they are acknowledged, and each rig (`_watched_rig`)
has a queue of bounded length (`_sample_queue`) that turns them into steps of its observer.

Rigs of one structure are in the lanes of a block (`_lanes`): one compiled program takes a step of
64 observers and monitors, whatever their values are. A lane without a sample stays as it was, and
a rig that comes takes a free lane, so that nothing compiles again. What each lane says becomes
findings as beside a single rig (`jaxtwin.monitoring.LiveMonitor`).

Diagnoses and refits are jobs on an executor (`_jobs`). `fleet_app` (`_app`) is the web application
with what its page shows; the page of a single rig is drawn by the view of `jaxtwin.serve`.
`VirtualFleet` (`_virtual_fleet`) publishes virtual rigs, to try all this.
"""

from .._faces import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
