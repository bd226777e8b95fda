"""From a laboratory's own files to a push dataset.

A `Source` is a table of named columns with a clock; readers by kind of file make them. A setup.yaml says
where object pose, finger and force are, in which units, frames and signs (`import_setup`); `mapping` makes
channels of sources, `clocks` brings them to one clock by contact, and `recordings` cuts them into pushes and
says in the dataset's `provenance` what was done. docs/import.md has a setup.yaml for each kind of file.
"""

from slipmap.models.measurements.importing.guess import guess_setup
from slipmap.models.measurements.importing.recordings import import_dataset
