"""The reference: exact expectations of what the engine estimates, by master equations.
It shares the reduction of parameters and the contact laws with the engine, and no
solver."""
