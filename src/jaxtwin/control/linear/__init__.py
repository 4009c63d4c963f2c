"""Linear models of a twin: made at an operating point or a state of a run, discretised, reduced,
analysed (frequency response, margins, directions), and the Riccati equations of gains."""
