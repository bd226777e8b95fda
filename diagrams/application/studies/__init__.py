"""Studies that take long: blind tests of the diagnosis."""
