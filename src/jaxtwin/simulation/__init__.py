"""Simulation: one run or many draws.

The default solver is exponential time differencing in the modes of the thermal network, on a time
grid that is fine after each input change; any diffrax solver can take its place. Which file holds
what:

- the inputs: `_drive` (with the driver's lag and delay), `_initial`, `_time_grid` (few sizes, few
  compiled programs), `_check_values`
- the default solver: `_modes`, `_exponential` (a step), `_integrate` (all steps), `_interpolation`
  (samples inside a step), `_refinement` (were the steps short enough?)
- inputs besides the duty: `_input_levels` (and how fast a rig answers to each), `_held_inputs`
  (steps that contain several changes)
- large plates: `_reduced_modes`, the few modes that the drive reaches; `_grid_convergence`, the
  grid by the accuracy wanted
- one run: `_simulate`, `_run` (its result), `_power`
- many draws: `_simulate_batch`, `_draw_solver`,
  `_chunk_programs`, `_compressed`, `_reductions` (what is kept), `_draw_units` and `_workers`
  (cores, accelerators, clusters)
- many draws on a CPU with a C compiler: `rodas5p.c`, a draw in each lane of a vector;
  `_native_library` (compiled and loaded), `_native_network` (a network as its tables and numbers),
  `_native_inputs` (what inputs change in it),
  `_native_steps` (its time grid), `_native_chunk` (a call)
- one step at a time, for observers and controllers: `_stepper`, `_step_preparation`,
  `_reduced_stepper`
- diffrax: `_diffeqsolve`, `_diffrax_programs`, `_network_exponential` (our step as its solver),
  `_rodas5p` (a solver for any stiff equations, with `_rosenbrock_step`)
- a million draws and more on an accelerator: `_scalar_chunk` (by Rodas5P),
  `_scalar_network` (the equations as single numbers)
"""

from .._faces import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
