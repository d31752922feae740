"""`[geometry]`: the domain of a case and the kind of its mesh."""

from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, model_validator

from signorini_fenicsx.cases.parts import Section
from signorini_fenicsx.cases.values import ShapeName, choice
from signorini_fenicsx.meshes.shapes import SHAPES, shape_of


class Geometry(Section):
    """`[geometry]`: a named shape and the kind of its mesh; or a file with a mesh, or with a geometry for Gmsh."""

    shape: ShapeName | None = None
    file: Annotated[str, Field(min_length=1)] | None = None
    mesh: Annotated[str, choice("mesh", ("unstructured", "structured", "gmsh"))] = "unstructured"
    diagonal: Annotated[str, choice("diagonal", ("left", "right", "crossed"))] | None = None

    @model_validator(mode="after")
    def _mesh_exists(self) -> Self:
        if (self.shape is None) == (self.file is None):
            raise ValueError("must have either a shape, such as 'square', or a file, such as 'mesh.msh'")
        if self.shape is None:
            if {"mesh", "diagonal"} & self.model_fields_set:
                raise ValueError("mesh and diagonal apply to named shapes, not to files")
            return self
        shape = shape_of(self.shape)
        if self.mesh == "structured" and shape.grid is None:
            structured = ", ".join(name for name, other in SHAPES.items() if other.grid is not None)
            raise ValueError(f"shape '{self.shape}' has no structured mesh; only rectangles, {structured} have")
        if self.diagonal is not None and (self.mesh != "structured" or shape.dim != 2):
            raise ValueError("diagonal applies to structured meshes of square, lshape and rectangles only")
        return self

    @property
    def name(self) -> str:
        """The shape, or the name of the file."""
        return self.shape or Path(self.file or "").name
