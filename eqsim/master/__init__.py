"""The master room expects: it computes what the engine estimates, and shares nothing with it but the contact laws."""
