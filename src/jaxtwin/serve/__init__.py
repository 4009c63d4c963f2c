"""A rig and its twin as a page in a browser: `jaxtwin serve`.

There is one loop (`_rig_loop`), in the main thread, and one twin beside the rig (`TwinBeside`),
however many clients look. `Page` (`_page`) is a consumer of the loop's service, as a screen is. It
puts frames (`_contents`), with the story of the rig in three sentences (`_story`) and what the twin
expects of the next minute, into a ring (`_frame_ring`), and readings into a history of
fixed size (`_history`). `Champion` follows the champion of a store of twins. `LiveDiagnosis` says
why a rig has changed, and `LiveRefit` refits the champion, both from the last minutes
(`_recent_samples`) and in processes of their own, as a virtual rig has one (`_child_process`).
`PageServer` (`_page_server`) assembles everything; `_live_demo` is a story.

A run is commanded by a held duty or by a controller at held references (`_order_in_force`).
`SelfOptimiser` (`_self_optimiser`) has that controller tuned when the champion was refitted, and
the loop goes back to the one before if the new one is worse on the rig than in its trial.

The web server (`_web_server`) runs in a second thread. It reads the ring and the history, and
leaves orders (`_orders`) at a desk (`_desk`), which the loop takes: a run is commanded by
`jaxtwin.live.operate`, behind all interlocks. Orders to the store also come from an MQTT broker.
`_access` says who may ask for what, `_metrics` is the text for Prometheus, `_app`
the application with the streams of its clients. `assets/` holds the page: `view.js` draws it from
frames, wherever they come from.

The web server needs the extra `serve`; it is imported when one is made.
"""

from .._faces import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
