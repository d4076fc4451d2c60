"""Settings of a camera: which of the driver's many are offered, and how they are read and changed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from ...errors import SourceError
from ..base import CameraOption, CameraRole
from .devices import DeviceInfo
from .driver import load_driver

VISUAL_PRESET: Final = "visual_preset"
_AUTO_EXPOSURE: Final = "enable_auto_exposure"

#: What is offered where the camera has it, in the order in which it is applied: description and unit.
_OFFERED: Final = {
    VISUAL_PRESET: ("A set of values for a purpose; choosing one changes other settings.", ""),
    _AUTO_EXPOSURE: ("Let the camera choose its exposure and gain; 1 on, 0 off.", ""),
    "exposure": ("Exposure time; setting it turns the automatic off.", "us"),
    "gain": ("Amplification of the image sensor; more is brighter and noisier.", ""),
    "emitter_enabled": ("The infrared projector; 0 off, 1 on.", ""),
    "laser_power": ("Power of the infrared laser; less helps near objects, which else are too bright.", ""),
    "receiver_gain": ("Gain of the laser's receiver; less helps near objects, more helps dark ones.", ""),
    "digital_gain": ("Gain after the laser's receiver: 1 high, 2 low, for places with ambient light.", ""),
    "confidence_threshold": ("Depths that the camera is less sure of are left out.", ""),
    "min_distance": ("Depths nearer than this are left out.", "mm"),
    "noise_filtering": ("Strength of the camera's own noise filter.", ""),
    "pre_processing_sharpening": ("Sharpening before depth is computed.", ""),
    "post_processing_sharpening": ("Sharpening of the depth image.", ""),
}
#: What an L515's visual preset sets as well.
_SET_BY_PRESET: Final = frozenset(_OFFERED) - {VISUAL_PRESET, _AUTO_EXPOSURE, "exposure", "gain", "emitter_enabled"}

#: The membrane is nearer to an L515 than its ordinary presets are made for.
_SHORT_RANGE: Final = 5.0


@dataclass(frozen=True)
class SensorOptions:
    """The settings of one camera's depth sensor.

    Attributes
    ----------
    sensor : the driver's sensor
    """

    role: CameraRole
    info: DeviceInfo
    sensor: Any

    def read(self) -> tuple[CameraOption, ...]:
        """Return what can be set, with the present values."""
        options = []
        for name in _OFFERED:
            try:
                option = self._read(name)
            except RuntimeError:  # some cannot be read in some modes
                continue
            if option is not None:
                options.append(option)
        return tuple(options)

    def set(self, name: str, value: float) -> None:
        """Change one setting.

        Raises
        ------
        SourceError
            The camera does not have it or refuses the value.
        """
        option = getattr(load_driver().option, name, None) if name in _OFFERED else None
        if option is None or not self.sensor.supports(option):
            known = ", ".join(known.name for known in self.read())
            raise SourceError(f"the {self.info.title} has no option {name!r}; it has {known or 'none'}")
        try:
            self.sensor.set_option(option, value)
        except RuntimeError as error:
            extent = self.sensor.get_option_range(option)
            raise SourceError(
                f"the {self.info.title} refuses {name} = {value:g} ({error}); "
                f"allowed are {extent.min:g} to {extent.max:g} in steps of {extent.step:g}"
            ) from error

    def apply(self, wanted: Mapping[str, float]) -> list[str]:
        """Change many settings, and return a sentence for each that the camera does not take."""
        refused = []
        for name in sorted(wanted, key=_place):
            if name in ("exposure", "gain") and wanted.get(_AUTO_EXPOSURE):
                continue  # would turn the automatic off again
            try:
                self.set(name, wanted[name])
            except SourceError as error:
                text = str(error)
                refused.append(f"{text[0].upper()}{text[1:]}.")
        return refused

    def _read(self, name: str) -> CameraOption | None:
        option = getattr(load_driver().option, name, None)
        if option is None or not self.sensor.supports(option):
            return None
        extent = self.sensor.get_option_range(option)
        description, unit = _OFFERED[name]
        return CameraOption(
            camera=self.role,
            name=name,
            description=description,
            minimum=float(extent.min),
            maximum=float(extent.max),
            step=float(extent.step),
            # What a camera gets where a preset says nothing: presets leave such values out.
            default=wanted_options(self.info, {}).get(name, float(extent.default)),
            value=float(self.sensor.get_option(option)),
            unit=unit,
            choices=self._choices(option, extent) if name == VISUAL_PRESET else (),
            read_only=bool(self.sensor.is_option_read_only(option)),
        )

    def _choices(self, option: Any, extent: Any) -> tuple[tuple[float, str], ...]:
        driver = load_driver()
        enumeration = driver.l500_visual_preset if self.info.is_proximity_model else driver.rs400_visual_preset
        names = {int(member): name.replace("_", " ") for name, member in enumeration.__members__.items()}
        choices = []
        for number in range(int(extent.min), int(extent.max) + 1):
            told = self.sensor.get_option_value_description(option, float(number))
            if told or number in names:
                choices.append((float(number), str(told or names[number])))
        return tuple(choices)


def wanted_options(info: DeviceInfo, stored: Mapping[str, float]) -> dict[str, float]:
    """Return what to set on a camera: what the preset says, and an L515 to short range where it says nothing."""
    defaults = {VISUAL_PRESET: _SHORT_RANGE} if info.is_proximity_model else {}
    return {**defaults, **stored}


def remember(wanted: dict[str, float], name: str, value: float) -> None:
    """Note a changed setting among those that are set again whenever the camera is opened."""
    if name == VISUAL_PRESET:
        for other in _SET_BY_PRESET & wanted.keys():
            del wanted[other]
    wanted[name] = value


def _place(name: str) -> int:
    names = list(_OFFERED)
    return names.index(name) if name in names else len(names)
