"""Long-running studies: calibration of intervals and blind tests of the diagnosis."""
