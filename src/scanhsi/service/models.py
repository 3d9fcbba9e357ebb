"""What goes over the wire: requests as they are checked, answers as they are described."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from scanhsi.devices import PixelFormat
from scanhsi.engine import Mode, OnFault
from scanhsi.engine.reopening import DeviceRole
from scanhsi.service.downloads import DownloadFormat
from scanhsi.service.folder import NAME
from scanhsi.service.jobs import Job, JobState, plain
from scanhsi.service.lease import DEFAULT_S, LONGEST_S, SHORTEST_S
from scanhsi.service.problems import problem_of

Name = Annotated[str, Field(pattern=NAME, description="Name in the data folder.", examples=["hand.zarr"])]
Step = Annotated[int, Field(ge=-(2**31), le=2**31 - 1, description="Motor step.", examples=[120])]


class Body(BaseModel):
    """A request; unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class Problem(BaseModel):
    """RFC 9457 problem details: the Python exception, over the wire."""

    model_config = ConfigDict(extra="allow")

    type: str = Field(description="Address of the explanation.", examples=["/api/v1/problems/OutOfRange"])
    title: str = Field(examples=["Out of range"])
    status: int = Field(examples=[422])
    detail: str = Field(description="What happened.", examples=["exposure 9 s is not allowed; allowed is 0.01 to 2 s."])
    error: str = Field(description="Class of the Python exception.", examples=["OutOfRange"])
    hint: str | None = Field(default=None, description="What to try.")
    device: str | None = None
    operation: str | None = None
    line: int | None = Field(default=None, description="Line of the scan.")
    waited_s: float | None = None
    problems: list[str] | None = Field(default=None, description="One sentence a problem of a plan or option.")
    causes: list[dict[str, Any]] | None = Field(default=None, description="Problems behind this one.")


class MirrorModel(BaseModel):
    """Where the mirror is."""

    step: int | None = Field(description="As the controller confirmed it; null where it is not known.")
    homed: bool = Field(description="Whether steps mean angles.")
    angle_rad: float | None = Field(description="From the position in which the mirror stands at 45 degrees.")
    moving: bool


class CameraModel(BaseModel):
    """Settings of the camera: of the live view, and of plans that say nothing else."""

    exposure_s: float = Field(examples=[0.02])
    gain_db: float = Field(examples=[0.0])
    pixel_format: PixelFormat


class HolderModel(BaseModel):
    """Who is in control."""

    name: str
    remaining_s: float = Field(description="Until control runs out, if nothing is heard of them.")


class StateModel(BaseModel):
    """How things stand."""

    instrument: str
    run: str = Field(description="Identifies this opening of the instrument, in logs and cubes.")
    simulated: bool = Field(description="Whether any device is not a real one.")
    lost: dict[DeviceRole, str] = Field(
        description="Devices that were lost, and what happened to each: the next command that needs them opens them anew."
    )
    busy: Literal["idle", "live", "moving", "job"] = Field(description="What uses the devices.")
    live: bool = Field(description="Whether the live view is switched on.")
    job: str | None = Field(description="The job under way.")
    mirror: MirrorModel
    camera: CameraModel
    scene: str | None = Field(description="What a simulated camera looks at.")
    lease: HolderModel | None
    viewers: int
    listeners: int
    free_bytes: int = Field(description="On the disk of the data folder.")
    started: str


class CapabilitiesModel(BaseModel):
    """What the instrument is and allows."""

    name: str
    description: str
    simulated: bool
    camera: dict[str, Any] = Field(description="As scanhsi.devices.CameraInfo, narrowed by the limits of the file.")
    actuator: dict[str, Any] = Field(description="As scanhsi.devices.ActuatorInfo, narrowed by the limits of the file.")
    abilities: dict[str, list[str]] = Field(description="Optional abilities of camera and actuator.")
    scenes: list[str] = Field(description="What a simulated camera can look at; empty for a real one.")
    config: dict[str, Any] = Field(description="The instrument file.")
    default_plan: dict[str, Any]
    shape: tuple[int, int] = Field(description="(bands, samples) of a line.")
    wavelength_nm: list[float] | None = Field(description="Of the bands; null without calibration.")
    modes: list[Mode]
    calibrations: list[str]
    formats: list[str] = Field(description="That cubes can be downloaded in.")
    versions: dict[str, str]


class CameraPatch(Body):
    """Settings to change; what is left out stays."""

    exposure_s: float | None = Field(default=None, gt=0, examples=[0.02])
    gain_db: float | None = Field(default=None, ge=0, examples=[0.0])
    pixel_format: PixelFormat | None = None


class SwitchBody(Body):
    """On or off."""

    on: bool


class SceneBody(Body):
    """What a simulated camera is to look at."""

    scene: str = Field(max_length=100, examples=["white"])


class ReopenBody(Body):
    """Which devices are to be opened anew."""

    devices: list[DeviceRole] = Field(default=[], max_length=3, description="Those that were lost, if left out.")


class GoTo(Body):
    """Where the mirror is to go."""

    step: Step


class Jog(Body):
    """By how much the mirror is to move."""

    steps: Step


class TakeLease(Body):
    """Who wants control."""

    name: str = Field(min_length=1, max_length=80, description="As others shall see it.", examples=["Ada at the bench"])
    ttl_s: float = Field(default=DEFAULT_S, ge=SHORTEST_S, le=LONGEST_S, description="Runs out without a sign of life.")


class LeaseModel(BaseModel):
    """Control, for its holder."""

    id: str = Field(description="Send it in the header Scanhsi-Lease; a secret.")
    holder: HolderModel


class LeaseState(BaseModel):
    """Control, for everybody."""

    holder: HolderModel | None


_MAY_BE_NULL = ("start", "period_s", "look_ahead")


class PlanBody(Body):
    """A plan; what is left out is taken from the camera's settings, then from the instrument file."""

    lines: int | None = Field(default=None, gt=0, le=1_000_000, examples=[300])
    exposure_s: float | None = Field(default=None, gt=0, examples=[0.02])
    gain_db: float | None = Field(default=None, ge=0)
    pixel_format: PixelFormat | None = None
    mode: Mode | None = None
    step: Step | None = Field(default=None, description="Motor steps from one line to the next.")
    start: Step | None = Field(default=None, description="Step of the first line; centred on the normal if left out.")
    period_s: float | None = Field(default=None, gt=0, description="Line period of a continuous scan.")
    look_ahead: float | None = Field(default=None, ge=0, le=0.5, description="Accepted probability of a smeared line.")
    on_fault: OnFault | None = Field(default=None, description="skip, retry or abort.")
    line_retries: int | None = Field(default=None, ge=0, le=250)
    retries: int | None = Field(default=None, ge=0, le=1_000_000)
    recover_within_s: float | None = Field(default=None, gt=0)

    def given(self) -> dict[str, Any]:
        """Fields that were set; null only where it means something."""
        fields = self.model_dump(exclude_unset=True)
        return {name: value for name, value in fields.items() if value is not None or name in _MAY_BE_NULL}


class ScanBody(Body):
    """A scan to be taken."""

    plan: PlanBody = Field(default_factory=PlanBody)
    output: Name | None = Field(default=None, description="Cube to create; a name with date and time if left out.")
    discard: bool = Field(default=False, description="Store nothing: measure how fast it goes.")
    target: str | None = Field(
        default=None, max_length=200, description="What is before the instrument; kept in the cube."
    )
    recipe: Name | None = Field(default=None, description="Recipe to begin with; the plan goes before it.")
    real_time: str | None = Field(
        default=None,
        max_length=40,
        description="Options against lateness: gc, fifo, switch, with commas between; or all.",
    )


class JobModel(BaseModel):
    """A scan, a calibration, a benchmark: something that takes a while."""

    id: str
    kind: str = Field(examples=["scan"])
    title: str
    state: JobState
    created: str
    ended: str | None
    prompt: str | None = Field(description="What a person is asked to do before it goes on; then confirm it.")
    message: str | None = Field(description="What is being done.")
    can_pause: bool
    progress: dict[str, Any] | None = Field(description="Of a scan: lines, taken, stored, missing, efficiency, ...")
    output: str | None = Field(description="Name of what it makes.")
    request: dict[str, Any]
    result: dict[str, Any] | None = Field(description="Of a scan: scanhsi.ScanReport.")
    problem: dict[str, Any] | None = Field(description="Why it failed: problem details.")

    @staticmethod
    def of(job: Job) -> JobModel:
        """As everybody may see it."""
        return JobModel(
            id=job.id,
            kind=job.kind,
            title=job.title,
            state=job.state,
            created=job.created,
            ended=job.ended,
            prompt=job.prompt,
            message=job.message,
            can_pause=job.control is not None,
            progress=job.progress,
            output=job.output,
            request=job.request,
            result=plain(job.result) if job.result is not None else None,
            problem=plain(problem_of(job.error)) if job.error is not None else None,
        )


class CubeEntry(BaseModel):
    """A cube in the list."""

    id: str
    bands: int
    lines: int = Field(description="Reached so far.")
    samples: int
    lines_planned: int
    lines_stored: int
    lines_missing: int
    complete: bool
    simulated: bool | None
    dtype: str
    size_bytes: int
    modified: str
    target: str | None


class CubeInfo(CubeEntry):
    """A cube, with what it says of itself."""

    significant_bits: int | None
    wavelength_nm: list[float] | None
    missing_reasons: dict[int, str]
    attributes: dict[str, Any] = Field(description="Plan, instrument, devices, versions, acquisition.")


class SpectrumModel(BaseModel):
    """A spectrum at a point, or the mean over a region."""

    cube: str
    quantity: str = Field(examples=["counts"])
    wavelength_nm: list[float] | None
    mean: list[float | None]
    sigma: list[float | None] = Field(description="Standard deviation over the pixels; null at a point.")
    pixels: int


class SpectraModel(BaseModel):
    """Spectra of several pixels."""

    cube: str
    quantity: str
    wavelength_nm: list[float] | None
    lines: list[int]
    samples: list[int]
    spectra: list[list[float | None]]


class Recipe(Body):
    """A named plan."""

    plan: PlanBody = Field(default_factory=PlanBody)
    target: str | None = Field(default=None, max_length=200)
    note: str | None = Field(default=None, max_length=1000)


class RecipeEntry(Recipe):
    """A recipe in the list."""

    name: str


class FieldBody(Body):
    """A field of view."""

    height_mm: float = Field(ge=0.001, le=100_000, description="Length along the scan.", examples=[100.0])
    step: int | None = Field(
        default=None, ge=1, le=100_000, description="Steps from line to line; square pixels if left out."
    )
    f_number: float | None = Field(default=None, ge=0.1, le=1000)
    focal_mm: float | None = Field(default=None, ge=0.1, le=10_000)


class FieldPlanModel(BaseModel):
    """A scan of a field; see scanhsi.characterise.planner.FieldPlan."""

    lines: int
    step: int
    start: int
    line_pitch_mm: float
    edge_pitch_mm: float
    sample_pitch_mm: float
    aspect: float = Field(description="Line pitch over sample pitch; 1 is a square pixel.")
    height_mm: float
    width_mm: float
    view_rad: float
    linear: bool
    defocus_mm: float
    depth_of_field_mm: float | None
    sharp: bool | None


class PlanTime(BaseModel):
    """What a plan costs, from the delays of the instrument; see scanhsi.timing.prediction.Prediction."""

    mode: Mode
    pixel_format: PixelFormat
    period_s: float
    means_period_s: float
    lines_per_second: float
    efficiency: float
    scan_s: float
    circuit: str
    critical: list[str]
    smear: float = Field(description="Part of a line pitch that passes during an exposure.")
    mtf: float
    marks: list[str] = Field(description="Where the delays come from.")


class PlanField(BaseModel):
    """What a plan shows, in the object plane."""

    height_mm: float | None
    y_mm: list[float | None]
    width_mm: float | None
    line_pitch_mm: float
    sample_pitch_mm: float | None
    aspect: float | None = Field(description="Line pitch over sample pitch; 1 is a square pixel.")
    square_step: int | None = Field(description="Step that makes pixels most nearly square.")
    edge_stretch: float | None = Field(description="Line pitch at the ends over that at the normal.")
    defocus_mm: float | None = Field(description="How much farther away the ends are.")
    linear: bool = Field(description="Within 22.5 degrees of the normal (Eq. 13).")


class PlanFacts(BaseModel):
    """What a plan comes to."""

    plan: dict[str, Any]
    first_step: int
    last_step: int
    size_bytes: int = Field(description="Of the pixels, before they are compressed.")
    time: PlanTime | None = Field(description="Null where the delays of the instrument are not known.")
    field: PlanField


class ResultEntry(BaseModel):
    """The result of a calibration."""

    id: str
    kind: str
    taken: str
    age_s: float | None
    simulated: bool | None
    temperature_c: float | None
    applies: bool = Field(description="Whether it may be used on cubes taken now: age, gain, format, region.")
    why_not: str | None
    conditions: dict[str, Any] = Field(description="Under which it was taken: gain, format, region.")
    rows: list[dict[str, Any]] = Field(description="Rows of the specification sheet.")


class SheetModel(BaseModel):
    """The specification sheet; see scanhsi.characterise.spec.Sheet."""

    name: str
    simulated: bool
    table: list[dict[str, Any]] = Field(description="Rows of Table 7 of the paper.")
    further: list[dict[str, Any]]
    created: str
    version: str


class DownloadBody(Body):
    """As what a cube is to be downloaded."""

    format: DownloadFormat = "zarr"


class DownloadModel(BaseModel):
    """Where it is."""

    url: str
    expires_s: float


class ProblemKind(BaseModel):
    """What an error means."""

    error: str
    explanation: str


class BenchmarkBody(Body):
    """Scans that store nothing, to see how fast the instrument is."""

    exposures_s: list[Annotated[float, Field(gt=0)]] = Field(default=[0.02, 0.05, 0.1], min_length=1, max_length=20)
    modes: list[Mode] = Field(default=[Mode.SEQUENTIAL, Mode.STEPPED, Mode.CONTINUOUS], min_length=1, max_length=3)
    pixel_formats: list[PixelFormat] = Field(default=[PixelFormat.MONO8], min_length=1, max_length=4)
    lines: int = Field(default=50, ge=10, le=1000)
