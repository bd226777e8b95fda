from .assertions import (
    CommandLog as CommandLog,
    assert_adopts as assert_adopts,
    assert_alarm as assert_alarm,
    assert_better_than_uniform as assert_better_than_uniform,
    assert_held as assert_held,
    assert_limits_kept as assert_limits_kept,
    assert_names as assert_names,
    assert_predicts as assert_predicts,
    assert_quiet as assert_quiet,
)
from .cell import (
    LOCKSTEP as LOCKSTEP,
    TWIN as TWIN,
    Cell as Cell,
    Faults as Faults,
    open_cell as open_cell,
    small_scenario as small_scenario,
)
from .faults import Fault as Fault
