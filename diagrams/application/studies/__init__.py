"""Studies that take long: soaks of a cell, and blind tests of the diagnosis."""
