"""The figures of Braun and Peyrard (2011): `python -m analysis.figures` makes them."""
