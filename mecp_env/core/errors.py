"""Errors a user can cause: each names the field, the value and the bound."""


class MecpError(ValueError):
    """Base of all errors that mecp_env raises for bad input."""


class ConfigError(MecpError):
    """A configuration field is unknown, of the wrong type or out of its bounds."""


class KeywordError(ConfigError, TypeError):
    """A keyword is unknown; a `TypeError` too, since libraries that try keywords catch Python's own error."""


class ActionError(MecpError):
    """An action does not lie in the action space; the environment is as it was before."""


class SensorError(MecpError):
    """A scan or an odometry reading has the wrong shape or type, is not finite, or is out of bounds."""


class LayoutError(MecpError):
    """A layout or plan file is damaged, out of its limits, or geometrically impossible."""


class LogError(MecpError):
    """A log is damaged, of an unknown format, or without the laser or odometry that is asked for."""


class PlanWarning(UserWarning):
    """A floor plan can be read in more than one way; the message names the level, its share and the option."""
