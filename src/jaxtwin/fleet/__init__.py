"""A fleet of rigs, watched from the topics of a broker: `jaxtwin fleet`."""
