"""The output errors of one recording, split into channels, common mode and camera."""

from typing import NamedTuple, final

import numpy as np
from jaxtyping import Float


@final
class RecordingErrors(NamedTuple):
    """Simulated minus recorded temperatures of one recording in three parts, K.

    - `channel`: the errors of each channel, without the common mode.
    - `common_mode`: the mean over the channels, without the camera's error.
    - `camera`: the camera's common error.
    """

    channel: Float[np.ndarray, "times channels"]
    common_mode: Float[np.ndarray, " times"]
    camera: Float[np.ndarray, " times"]

    def mean_over_channels(
        self, weights: Float[np.ndarray, "times channels"]
    ) -> Float[np.ndarray, " times"]:
        """The mean error of all channels, including the camera's error, K.

        Times without counted samples are interpolated: a mean over the other channels would jump
        when a channel begins or ceases to count.
        """
        mean = self.common_mode + self.camera
        if (weights > 0).all():
            return mean
        whole, times = self.channel + mean[:, None], np.arange(len(mean))
        columns = [
            np.interp(times, times[weight > 0], column[weight > 0])
            for column, weight in zip(whole.T, weights.T, strict=True)
            if weight.any()
        ]
        return np.mean(columns, axis=0)
