"""What motors make of a command."""

from invdyn.diagnosis.catalogue.entry import CatalogueEntry
from invdyn.models.effects.motors import ActuatorDeadzone, ActuatorDelay, ActuatorGain, ActuatorLag, ActuatorSaturation

ENTRIES = (
    CatalogueEntry(
        ActuatorDeadzone,
        phrase="an actuator dead zone",
        meaning="commands too small to turn into torque",
        shown_by="small commands",
    ),
    CatalogueEntry(
        ActuatorDelay,
        phrase="actuator delay",
        meaning="torques that come later than commanded",
        shown_by="a common clock of camera and motors, such as a light that the command switches",
        needs={"": "command"},
        twins={"camera_latency": {"delay": "latency"}},
        file_change="motor delay",
    ),
    CatalogueEntry(
        ActuatorGain,
        phrase="an actuator gain",
        meaning="torques larger or smaller than commanded, by one factor; of a servo its gain",
        shown_by="a known weight at the tip, or a passive swing",
        forms={"geared": "as of a torque that was logged before its gear"},
        needs={"": "command", "geared": "torque"},  # a target has no gear that may be left out
        file_change="motor gain",
    ),
    CatalogueEntry(
        ActuatorLag,
        phrase="actuator lag",
        meaning="torques that follow the command sluggishly",
        shown_by="a command that sweeps to high frequencies",
        needs={"": "command"},
    ),
    CatalogueEntry(
        ActuatorSaturation,
        phrase="actuator saturation",
        meaning="torques that stop growing at a limit",
        shown_by="a ladder of amplitudes",
        file_change="motor limit",
    ),
)
