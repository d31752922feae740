"""`[geometry]`: the domain of a case and the kind of its mesh."""

from collections.abc import Mapping
from typing import Annotated, Self

from pydantic import BeforeValidator, Field, model_validator

from signorini_fenicsx.cases.complaints import shown, told
from signorini_fenicsx.cases.parts import Section
from signorini_fenicsx.cases.values import Positive, ShapeName, choice, number
from signorini_fenicsx.meshes.bodies import Bodies, Body, check_name
from signorini_fenicsx.meshes.files import is_geometry
from signorini_fenicsx.meshes.meshing import MeshFile, Source
from signorini_fenicsx.meshes.named_faces import Rule, check_rule
from signorini_fenicsx.meshes.shapes import SHAPES, shape_of


class Meshed(Section):
    """A named shape and the kind of its mesh; or a file with a mesh, or with a geometry for Gmsh."""

    shape: ShapeName | None = None
    file: Annotated[str, Field(min_length=1)] | None = None
    mesh: Annotated[str, choice("mesh", ("unstructured", "structured", "gmsh"))] = "unstructured"
    diagonal: Annotated[str, choice("diagonal", ("left", "right", "crossed"))] | None = None
    faces: Annotated[
        dict[str, Annotated[Rule, BeforeValidator(check_rule)]], Field(default={}, exclude_if=lambda each: not each)
    ]

    sizes: Annotated[dict[str, Positive], Field(default={}, exclude_if=lambda each: not each)]

    @model_validator(mode="after")
    def _mesh_exists(self) -> Self:
        if self.shape is None:
            if {"mesh", "diagonal"} & self.model_fields_set:
                raise ValueError("mesh and diagonal apply to named shapes, not to files")
            if self.sizes and not is_geometry(self.file or ""):
                raise ValueError("sizes apply to drawings, such as .step and .geo; a mesh has its own")
            return self
        if self.faces or self.sizes:
            raise ValueError("faces and sizes apply to files; a named shape has names for its parts")
        shape = shape_of(self.shape)
        if self.mesh == "structured" and shape.grid is None:
            structured = ", ".join(name for name, other in SHAPES.items() if other.grid is not None)
            raise ValueError(f"shape '{self.shape}' has no structured mesh; only rectangles, {structured} have")
        if self.diagonal is not None and (self.mesh != "structured" or shape.dim != 2):
            raise ValueError("diagonal applies to structured meshes of square, lshape and rectangles only")
        return self


class BodyKeys(Meshed):
    """A body of `bodies`: a shape or a file, by how much it is moved, and its largest cell diameter."""

    offset: Annotated[list[Annotated[float, BeforeValidator(number), Field(allow_inf_nan=False)]], Field(default=[])]
    h: Positive | None = None

    @model_validator(mode="after")
    def _is_whole(self) -> Self:
        if (self.shape is None) == (self.file is None):
            raise ValueError("must have either a shape or a file")
        if self.shape is not None:
            shape = shape_of(self.shape)
            if shape.inside:
                raise ValueError(f"shape '{self.shape}' has a part inside, and is no body")
            if self.offset and len(self.offset) != shape.dim:
                raise ValueError(f"offset must have {shape.dim} numbers, not {len(self.offset)}")
        return self

    def made(self) -> Body:
        """The body."""
        return Body(**dict(self) | {"offset": tuple(self.offset), "sizes": tuple(self.sizes.items())})


def _bodies(value: object) -> object:
    """Read a text as the path of a file."""
    if not isinstance(value, Mapping) or not value:
        raise ValueError(f"must be a table with a file or a shape for each name, not {shown(value)}")
    for name in value:
        with told():
            check_name(name)
    return {name: {"file": body} if isinstance(body, str) else body for name, body in value.items()}


class Geometry(Meshed):
    """`[geometry]`: one shape, one file, or several bodies with meshes of their own."""

    bodies: Annotated[
        dict[str, BodyKeys] | None, BeforeValidator(_bodies), Field(default=None, exclude_if=lambda each: each is None)
    ]

    @model_validator(mode="after")
    def _one_domain(self) -> Self:
        if [self.shape, self.file, self.bodies].count(None) != 2:
            raise ValueError("must have one of: a shape, such as 'square'; a file, such as 'mesh.msh'; bodies")
        if self.bodies is not None and self.faces:
            raise ValueError("faces stand with the file of a body: bodies = {up = {file = …, faces = {…}}}")
        return self

    @property
    def name(self) -> str:
        """The shape, or the name of the file, or those of the bodies."""
        return self.shape or self.source.name

    @property
    def source(self) -> Source:
        """What the mesh is read or made from, if the domain is no named shape."""
        if self.bodies is not None:
            return Bodies({name: body.made() for name, body in self.bodies.items()})
        return MeshFile(self.file or "", self.faces, tuple(self.sizes.items()))

    @property
    def files(self) -> dict[str, str]:
        """The files, by their keys."""
        of_bodies = {f"geometry.bodies.{name}.file": body.file for name, body in (self.bodies or {}).items()}
        return {key: file for key, file in (of_bodies | {"geometry.file": self.file}).items() if file is not None}

    @property
    def takes_h(self) -> bool:
        """Whether the mesh can be made with an h."""
        return self.file is None or is_geometry(self.file)

    @property
    def needs_h(self) -> str | None:
        """A body whose mesh needs an h that it does not have, if there is one."""
        return next((name for name, each in (self.bodies or {}).items() if each.shape and each.h is None), None)
