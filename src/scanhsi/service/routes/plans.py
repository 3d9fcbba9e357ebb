"""Plan aids and recipes."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated

from fastapi import APIRouter, Path

from scanhsi.characterise.planner import plan_field_of
from scanhsi.service import plans, recipes
from scanhsi.service.folder import NAME
from scanhsi.service.jobs import plain
from scanhsi.service.models import FieldBody, FieldPlanModel, PlanBody, PlanFacts, Recipe, RecipeEntry
from scanhsi.service.routes.common import IN_CONTROL, StationHere, problems
from scanhsi.service.work import plan_for

router = APIRouter()
RecipeName = Annotated[str, Path(pattern=NAME, description="Name of the recipe.", examples=["hand"])]


@router.post("/plan", tags=["plans"], responses=problems())
async def check_plan(station: StationHere, body: PlanBody) -> PlanFacts:
    """What a plan will cost and show: time, size, field of view, pixels, smear. Nothing moves."""
    plan = plan_for(station, body.given())
    course = station.imager.course(plan)
    return PlanFacts(**await station.background.run(plans.plan_facts, station.imager.config, plan, course))


@router.post("/plan/field", tags=["plans"], responses=problems())
async def plan_field(station: StationHere, body: FieldBody) -> FieldPlanModel:
    """Lines and steps for a field of view, with square pixels unless a step is given."""
    found = plan_field_of(
        station.imager.config, body.height_mm, step=body.step, f_number=body.f_number, focal_mm=body.focal_mm
    )
    return FieldPlanModel(**plain(asdict(found)))


@router.get("/recipes", tags=["plans"], response_model_exclude_unset=True, responses=problems())
async def list_recipes(station: StationHere) -> list[RecipeEntry]:
    """All recipes."""
    return await station.background.run(recipes.recipes, station.folder)


@router.get("/recipes/{name}", tags=["plans"], response_model_exclude_unset=True, responses=problems(404))
async def get_recipe(station: StationHere, name: RecipeName) -> RecipeEntry:
    """One recipe."""
    return await station.background.run(recipes.read_recipe, station.folder, name)


@router.put(
    "/recipes/{name}",
    tags=["plans"],
    response_model_exclude_unset=True,
    dependencies=[IN_CONTROL],
    responses=problems(404),
)
async def put_recipe(station: StationHere, name: RecipeName, body: Recipe) -> RecipeEntry:
    """Keep a recipe; it replaces an older one of that name."""
    plan_for(station, body.plan.given())
    return await station.background.run(recipes.write_recipe, station.folder, name, body)


@router.delete("/recipes/{name}", tags=["plans"], status_code=204, dependencies=[IN_CONTROL], responses=problems(404))
async def delete_recipe(station: StationHere, name: RecipeName) -> None:
    """Remove a recipe."""
    await station.background.run(recipes.remove_recipe, station.folder, name)
