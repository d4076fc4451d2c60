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

    A stamp on the computer's clock is taken as it is. The camera's clock has jumped where its stamps step
    otherwise than the images' numbers, and the arrivals do not bear them out: a camera may pause, but then
    the arrivals pause as well. From a jump on, stamps are shifted so that the smallest delay from stamp to
    arrival is the usual one again.

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
        self._last: tuple[int, float, float] | None = None
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

    def place(self, number: int, stamp_s: float, arrival_s: float, *, on_host_clock: bool) -> float:
        """Return when an image was taken, in seconds on the computer's clock.

        Parameters
        ----------
        number : int
            The camera's number of the image, which counts images that were lost.
        stamp_s, arrival_s : float
            The camera's stamp, and when the image reached us, both in seconds.
        on_host_clock : bool
            Whether the driver says that the stamp counts on the computer's clock.
        """
        delay_s = arrival_s - stamp_s
        if self._last is None:
            self._start(delay_s, on_host_clock)
        elif self._has_jumped(number - self._last[0], stamp_s - self._last[1], arrival_s - self._last[2]):
            self.jumped_by_s = self._usual_s - (delay_s - self._shift_s)
            self._delays_s.clear()
            self._settling = SETTLING
        self._last = number, stamp_s, arrival_s
        self._delays_s.append(delay_s)
        self._follow()
        return stamp_s + self._shift_s

    def restart(self) -> None:
        """Forget the stamps so far: the camera has been opened anew and its clock may have started over."""
        self._last = None

    def _start(self, delay_s: float, on_host_clock: bool) -> None:
        self.is_shared = on_host_clock and -_LATEST_S < delay_s < _EARLIEST_S
        self._delays_s.clear()
        self._settling = 0
        self._shift_s = 0.0
        self._usual_s = delay_s if self.is_shared else 0.0

    def _has_jumped(self, images: int, step_s: float, arrival_step_s: float) -> bool:
        half_s = 0.5 * self._period_s
        too_far_s = step_s - max(images, 1) * self._period_s
        return too_far_s < -half_s or (too_far_s > half_s and step_s - arrival_step_s > half_s)

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
