"""How fast, how exact: measured beside the tools that people use for the same work today.

`python -m benchmarks.compare` runs everything (extra `[bench]`) and writes a table, a plot and the
numbers; `--quick` does it small. Each module without an underscore asks one question and can be run
by itself. `python -m benchmarks.accuracy` measures the default solver over the bounds of every rig.
"""
