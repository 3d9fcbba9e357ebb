"""The ``[camera]``, ``[actuator]`` and ``[light]`` tables: the name of a driver, and the options of that driver beside it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Self, cast

from pydantic import (
    BaseModel,
    ConfigDict,
    InstanceOf,
    ValidationError,
    WithJsonSchema,
    model_serializer,
    model_validator,
)

from scanhsi.devices import Actuator, Backend, Camera, Light, Role, find
from scanhsi.devices.errors import ConfigError, DeviceUnavailable
from scanhsi.instrument.problems import nested_problems, problems_of


class DeviceConfig(BaseModel):
    """One device table. In a file the options stand flat beside ``driver``; they are checked by the driver's own model.

    Attributes:
        driver: Name of an installed driver of this role (``scanhsi drivers``).
        options: That driver's options.
    """

    model_config = ConfigDict(frozen=True)
    role: ClassVar[Role]

    driver: str
    options: Annotated[InstanceOf[BaseModel], WithJsonSchema({"type": "object"})]

    @property
    def backend(self) -> Backend[Any]:
        """The driver.

        Raises:
            DeviceUnavailable: It cannot be loaded on this computer.
        """
        return find(self.role, self.driver)

    def ready_backend(self) -> Backend[Any]:
        """The driver, with all it needs.

        Raises:
            DeviceUnavailable: Something is missing on this computer; the message says what and how to get it.
        """
        backend = self.backend
        missing = backend.missing()
        if missing is not None:
            raise DeviceUnavailable(
                missing,
                device=f"{self.role.word} {self.driver}",
                hint="`scanhsi drivers` shows what each driver needs.",
            )
        return backend

    def with_option(self, name: str, value: object) -> Self:
        """A copy with one option changed.

        Raises:
            ConfigError: The driver has no such option, or refuses the value.
        """
        model = type(self.options)
        where = f"{self.role.word} driver {self.driver!r}"
        if name not in model.model_fields:
            raise ConfigError(f"{where} has no option {name!r}; it has: {', '.join(model.model_fields) or 'none'}.")
        try:
            options = model.model_validate({**_given(self.options), name: value})
        except ValidationError as error:
            raise ConfigError(f"{where} refuses an option:", problems_of(error, model)) from error
        return self.model_copy(update={"options": options})

    @model_validator(mode="before")
    @classmethod
    def _split(cls, data: Any) -> Any:
        """Find the driver and let its model check everything else in the table."""
        if not isinstance(data, Mapping):
            return data
        table = dict(cast("Mapping[str, Any]", data))
        driver = table.pop("driver", None)
        try:
            if not isinstance(driver, str):
                raise ConfigError(f'write driver = "..." with the name of a {cls.role.word} driver (`scanhsi drivers`)')
            model = find(cls.role, driver).options
        except ConfigError as error:
            raise nested_problems(
                [{"loc": ("driver",), "msg": error.message, "input": driver, "type": "driver"}]
            ) from error
        if isinstance(table.get("options"), model):
            return {"driver": driver, "options": table["options"]}
        try:
            return {"driver": driver, "options": model.model_validate(table)}
        except ValidationError as error:
            raise nested_problems(error.errors(include_url=False), model) from error

    @model_serializer
    def _flat(self) -> dict[str, Any]:
        return {"driver": self.driver, **self.options.model_dump(mode="json")}


class CameraConfig(DeviceConfig):
    """The ``[camera]`` table."""

    role = Role.CAMERA

    def create(self) -> Camera:
        """Make the camera; opens nothing.

        Raises:
            DeviceUnavailable: The driver lacks something on this computer.
        """
        return self.ready_backend().create(self.options)


class ActuatorConfig(DeviceConfig):
    """The ``[actuator]`` table."""

    role = Role.ACTUATOR

    def create(self) -> Actuator:
        """Make the actuator; opens nothing.

        Raises:
            DeviceUnavailable: The driver lacks something on this computer.
        """
        return self.ready_backend().create(self.options)


class LightConfig(DeviceConfig):
    """The ``[light]`` table."""

    role = Role.LIGHT

    def create(self) -> Light:
        """Make the light; opens nothing.

        Raises:
            DeviceUnavailable: The driver lacks something on this computer.
        """
        return self.ready_backend().create(self.options)


def _given(options: BaseModel) -> dict[str, Any]:
    return {name: getattr(options, name) for name in type(options).model_fields}
