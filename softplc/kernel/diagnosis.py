"""What the innovations of an observer say about its tuning: the codes of the lamp, and a sentence for each."""

from enum import IntEnum
from typing import Final


class Diagnosis(IntEnum):
    """The verdict on one window of innovations. Published as `<axis>.Consistency`."""

    NOT_ENOUGH_DATA = 0
    CONSISTENT = 1
    R_TOO_SMALL = 2
    R_TOO_LARGE = 3
    Q_TOO_SMALL = 4
    Q_TOO_LARGE = 5
    COVARIANCE_NOT_VALID = 6
    BLEED = 7
    NOT_RANDOM = 8


DIAGNOSIS_TEXT: Final[dict[Diagnosis, str]] = {
    Diagnosis.NOT_ENOUGH_DATA: "not enough data yet",
    Diagnosis.CONSISTENT: "consistent: the innovations are as large and as random as the tuning says",
    Diagnosis.R_TOO_SMALL: "R too small: the samples are noisier than the tuning says",
    Diagnosis.R_TOO_LARGE: "R too large: the samples are less noisy than the tuning says",
    Diagnosis.Q_TOO_SMALL: "Q too small: the axis moves more than the tuning allows, the estimate lags",
    Diagnosis.Q_TOO_LARGE: "Q too large: the axis moves less than the tuning allows, the estimate follows the noise",
    Diagnosis.COVARIANCE_NOT_VALID: "covariance not valid: P is not finite or has a negative eigenvalue",
    Diagnosis.BLEED: "not consistent while the velocity bleeds: switch bleed off to judge Q and R",
    Diagnosis.NOT_RANDOM: "innovations not random: the estimate swings, or samples come twice; Q and R cure neither",
}
