"""A camera's time stamps on the computer's clock, also while the camera's own clock jumps."""

from __future__ import annotations

from collections import deque
from typing import Final

#: After a jump so many images are placed by their arrival until the new offset is taken for granted.
SETTLING: Final = 30
#: A stamp on the computer's clock is between this much later and this much earlier than the image's arrival.
_LATEST_S: Final = 0.05
_EARLIEST_S: Final = 1.0
#: The usual delay grows by no more than this from image to image.
_RISE_S: Final = 2e-4


class StreamClock:
    """Takes the stamps of one stream to the computer's clock.

    A stamp on the computer's clock is taken as it is. Whether the camera's clock has jumped shows in the
    delay from stamp to arrival: transport can make an image late, but not earlier than usual, and it never
    makes stamps run backwards. From a jump on, stamps are shifted so that the smallest delay is the usual
    one again.

    Parameters
    ----------
    period_s : float
        Time between two images.
    """

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._delays_s: deque[float] = deque(maxlen=SETTLING)
        self._shift_s = 0.0
        self._settling = 0
        self._last_stamp_s: float | None = None
        self._usual_s = 0.0
        self.is_shared = True
        self.jumped_by_s = 0.0

    @property
    def settling(self) -> bool:
        """Whether images are being placed by their arrival because the clock has jumped."""
        return self._settling > 0

    @property
    def usual_delay_s(self) -> float:
        """The smallest delay from stamp to arrival while all was well; 0 where only arrivals are known."""
        return self._usual_s

    def place(self, stamp_s: float, arrival_s: float, *, on_host_clock: bool) -> float:
        """Return when an image was taken, in seconds on the computer's clock.

        Parameters
        ----------
        stamp_s, arrival_s : float
            The camera's stamp, and when the image reached us, both in seconds.
        on_host_clock : bool
            Whether the driver says that the stamp counts on the computer's clock.
        """
        delay_s = arrival_s - stamp_s
        if self._last_stamp_s is None:
            self._start(delay_s, on_host_clock)
        elif self._has_jumped(stamp_s - self._last_stamp_s, delay_s):
            self.jumped_by_s = self._usual_s - (delay_s - self._shift_s)
            self._delays_s.clear()
            self._settling = SETTLING
        self._last_stamp_s = stamp_s
        self._delays_s.append(delay_s)
        self._follow()
        return stamp_s + self._shift_s

    def restart(self) -> None:
        """Forget the stamps so far: the camera has been opened anew and its clock may have started over."""
        self._last_stamp_s = None

    def _start(self, delay_s: float, on_host_clock: bool) -> None:
        self.is_shared = on_host_clock and -_LATEST_S < delay_s < _EARLIEST_S
        self._delays_s.clear()
        self._settling = 0
        self._shift_s = 0.0
        self._usual_s = delay_s if self.is_shared else 0.0

    def _has_jumped(self, step_s: float, delay_s: float) -> bool:
        runs_back = step_s < 0.5 * self._period_s
        arrives_early = delay_s - self._shift_s < self._usual_s - 0.5 * self._period_s
        return runs_back or (step_s > 1.5 * self._period_s and arrives_early)

    def _follow(self) -> None:
        least_s = min(self._delays_s)
        if not self.is_shared:  # two quartz clocks drift apart, so the shift follows for ever
            self._shift_s = least_s
        elif self._settling:
            self._settling -= 1
            self._shift_s = least_s - self._usual_s
            if not self._settling and abs(self._shift_s) < 0.25 * self._period_s:
                self._shift_s = 0.0  # it has jumped back to where it was
        else:
            # Down at once, up slowly: a while in which everything is late says nothing about the clock.
            self._usual_s = min(self._delays_s[-1] - self._shift_s, self._usual_s + _RISE_S)
