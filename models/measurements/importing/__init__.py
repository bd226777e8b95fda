"""Import a laboratory's own files as a push dataset.

A `Source` is a table of named columns with a clock; there is a reader for each kind of file. A setup.yaml
states where object pose, finger and force are, in which units, frames and signs (`import_setup`); `mapping`
turns sources into channels, `clocks` aligns them to one clock by contact, and `recordings` cuts them into
pushes and records in the dataset's `provenance` what was done. docs/import.md has a setup.yaml for each kind
of file.
"""

from slipmap.models.measurements.importing.guess import guess_setup
from slipmap.models.measurements.importing.recordings import import_dataset
