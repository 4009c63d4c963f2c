"""The commands of the command line, one module each. Libraries that cost time are imported inside,
so that `jaxtwin --help` stays quick."""
