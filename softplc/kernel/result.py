"""What one scan of an observer did with one axis: the result code that every kernel returns."""

from enum import IntEnum


class Result(IntEnum):
    """Outcome of one scan. A kernel raises nothing and logs nothing; this code is all it says."""

    UPDATED = 0  # predicted and corrected
    INITIALISED = 1  # started on this measurement, then predicted and corrected
    DISABLED = 2  # EnableIn is false: y = x, y_dot = 0, the next enabled scan initialises
    DT_INVALID = 3  # dt is not above zero: y = x, y_dot = 0, state untouched
    S_NOT_POSITIVE = 4  # S <= 0 or NaN: the prediction is put out, K and P untouched
    SKIPPED = 5  # batch only: the row was not to be stepped, nothing was touched
    REJECTED = 6  # the innovation lies beyond the gate: the prediction is put out, the sample did not enter
    IMPACT = 7  # the constraint surface was reached, and the transition took place
    HELD = 8  # the estimate reached the constraint before the system did and waits there for its contact
    WARMING_UP = 9  # fewer samples than the observer needs: the outputs are provisional
