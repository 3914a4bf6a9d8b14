"""The description of the interface for programs (OpenAPI 3.1), made from the table of views."""

from collections.abc import Iterable, Sequence
from importlib.metadata import version
from typing import Any, Final

import msgspec

from fleet_backend.page.asking import TEXT, Parameter, ParameterType
from fleet_backend.page.view import View

_REF: Final = "#/components/schemas/{name}"


class Problem(msgspec.Struct, frozen=True, kw_only=True):
    """What went wrong (RFC 9457)."""

    title: str
    status: int
    detail: str


def openapi(views: Sequence[tuple[View, Sequence[Parameter]]]) -> dict[str, Any]:
    records = [view.answer for view, _ in views]
    schemas, components = msgspec.json.schema_components([*records, Problem], ref_template=_REF)
    problem = schemas[-1]
    paths = {
        view.api_path: {"get": _operation(view, parameters, schema, problem)}
        for (view, parameters), schema in zip(views, schemas, strict=False)
    }
    return {
        "openapi": "3.1.0",
        "info": {
            "title": "clutchdiag fleet",
            "version": version("clutchdiag"),
            "description": "What the fleet's database knows. SI units, UTC. Within v1 keys are only ever added.",
        },
        "paths": paths,
        "components": {"schemas": components},
    }


def _operation(view: View, parameters: Iterable[Parameter], schema: object, problem: object) -> dict[str, Any]:
    content = {"application/json": {"schema": schema}}
    wrong = {"content": {"application/problem+json": {"schema": problem}}}
    answers = {
        "200": {"description": view.text, "content": content},
        "400": {"description": "the request is not valid", **wrong},
        "401": {"description": "nobody is logged in", **wrong},
        "403": {"description": f"this takes the role {view.role.name.lower()}", **wrong},
        "404": {"description": "not found", **wrong},
        "503": {"description": "the database does not answer", **wrong},
    }
    return {
        "operationId": view.name,
        "summary": view.text,
        "parameters": [_parameter(one) for one in parameters],
        "responses": answers,
    }


def _parameter(one: Parameter) -> dict[str, Any]:
    described: dict[str, Any] = {
        "name": one.name,
        "in": "path" if one.in_path else "query",
        "required": one.is_required,
        "description": one.text,
        "schema": _schema(one),
    }
    may_be_empty = not one.in_path and not one.is_required  # as an empty field of a form: not said
    return {**described, "allowEmptyValue": True} if may_be_empty else described


def _schema(one: Parameter) -> dict[str, Any]:
    if one.kind is ParameterType.COUNT:
        limits: dict[str, Any] = {"type": "integer", "minimum": one.least, "maximum": one.most}
        return limits if one.default is None else {**limits, "default": one.default}
    schema: dict[str, Any] = {"type": "string", "maxLength": one.longest}
    if one.kind is ParameterType.MOMENT:
        schema["format"] = "date-time"
    if one.choices:
        schema["enum"] = list(one.choices)
    if one.pattern is not None:
        schema["pattern"] = f"^{one.pattern}$"
    elif one.kind is ParameterType.TEXT and not one.choices:
        schema["pattern"] = f"^{TEXT}$"
    return schema
