"""The engine draws: lives of contacts, the force of an ensemble, steady averages."""
