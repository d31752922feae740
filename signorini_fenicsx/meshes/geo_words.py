"""The words of Gmsh's language that a `.geo` file may use, and those that are not allowed as names of variables.

Every other word is a variable. The lists are from Gmsh's manual and its parser, version 4.15.
"""


def _words(*lines: str) -> frozenset[str]:
    return frozenset(" ".join(lines).split())


FLOW = _words("For EndFor If ElseIf Else EndIf Macro Function Return Call")
"""Words that control which lines are executed. Gmsh skips to the closing word without parsing."""

ALLOWED = FLOW | _words(
    # numbers
    "Pi newp newl newc newll newcl news newsl newv newreg newf GMSH_MAJOR_VERSION GMSH_MINOR_VERSION",
    "GMSH_PATCH_VERSION Exp Log Log10 Sqrt Sin Asin ArcSin Cos Acos ArcCos Tan Atan ArcTan Atan2 ArcTan2 Sinh Cosh",
    "Tanh Fabs Abs Floor Ceil Round Fmod Modulo Hypot Rand Max Min Step List LinSpace LogSpace Unique Catenary Find",
    "Exists In DefineConstant",
    # points, curves, surfaces, volumes
    "SetFactory Point Line Curve Spline CatmullRom BSpline Bezier Nurbs Knots Order Circle Ellipse Ellipsis Wire Loop",
    "Plane Ruled Surface Sphere PolarSphere Box Block Torus Rectangle Disk Cylinder Cone Wedge ThickSolid",
    "ThruSections Volume Compound Using Sewing GeoEntity",
    # what is made of them
    "Extrude Layers ScaleLastLayer Recombine Hole Translate Rotate Symmetry Dilate Affine Duplicata Boundary",
    "CombinedBoundary OrientedBoundary OrientedCombinedBoundary PointsOf Split Intersect Delete Recursive Coherence",
    "HealShapes Fillet Chamfer BooleanUnion BooleanFuse BooleanIntersection BooleanCommon BooleanDifference",
    "BooleanCut BooleanFragments BooleanCoherence BooleanSection",
    # what is asked of them
    "Parent BoundingBox Mass CenterOfMass MatrixOfInertia Parametric Normal Curvature Closest Show Hide",
    # sizes and names
    "Physical MeshSize Characteristic Length Transfinite Progression Bump Beta Left Right Alternate AlternateLeft",
    "AlternateRight Smoother Periodic Reverse ReverseMesh MeshAlgorithm MeshSizeFromBoundary Field Background",
    "BoundaryLayer",
)

TEXT = _words("Str StrCat Sprintf")
"""Functions that make the name of a physical group or the formula of a field."""

PARAMETER = _words("Name Label Help Units Min Max Step Choices Visible ReadOnly AutoCheck Highlight Closed")
"""Attributes of a parameter in DefineConstant."""

FIELDS = _words(
    "AttractorAnisoCurve Attractor AutomaticMeshSizeField Ball BoundaryLayer Box Constant Curvature Cylinder Distance",
    "Extend Frustum Gradient IntersectAniso Laplacian LonLat MathEval MathEvalAniso Max MaxEigenHessian Mean Min",
    "MinAniso Param Restrict Threshold",
)
"""Fields of sizes that use no file, no program and no view."""

FIELD_FORMULAS = _words("F FX FY FZ M11 M12 M13 M22 M23 M33 m11 m12 m13 m22 m23 m33")
"""Options of fields that are formulas in x, y, z."""

FIELD_OPTIONS = FIELD_FORMULAS | _words(
    "AnisoMax Beta BetaLaw CurvesList Delta DistMax DistMin EdgesList ExcludedFaceList ExcludedSurfacesList FacesList",
    "FanNodesList FanPointsList FanPointsSizesList FieldX FieldY FieldZ FieldsList FromStereo IField InField",
    "IncludeBoundary IncludeEmbedded InnerR1 InnerR2 InnerV1 InnerV2 IntersectMetrics Kind LcMax LcMin",
    "NNodesByEdge NbLayers NodesList NumPointsPerCurve OuterR1 OuterR2 OuterV1 OuterV2 PointsList Quads R1_inner",
    "R1_outer R2_inner R2_outer Radius RadiusStereo Ratio RegionsList Sampling Sigmoid Size SizeFar SizeMax",
    "SizeMaxNormal SizeMaxTangent SizeMin SizeMinNormal SizeMinTangent SizesList StopAtDistMax SurfacesList Thickness",
    "V1_inner V1_outer V2_inner V2_outer VIn VOut VerticesList VolumesList X1 X2 XAxis XCenter XMax XMin Y1 Y2 YAxis",
    "YCenter YMax YMin Z1 Z2 ZAxis ZCenter ZMax ZMin dMax dMin hfar hwall_n hwall_n_nodes lMaxNormal lMaxTangent",
    "lMinNormal lMinTangent ratio thickness",
)

OPTIONS = {
    "General": _words("Axes NumThreads RotationX RotationY RotationZ SmallAxes Terminal Trackball Verbosity"),
    "Geometry": _words(
        "AutoCoherence CopyMeshingMethod CurveLabels CurveNumbers CurveWidth Curves ExtrudeReturnLateralEntities",
        "ExtrudeSplinePoints HideCompounds HighlightOrphans LabelType LineNumbers LineWidth Lines MatchGeomAndMesh",
        "MatchMeshScaleFactor MatchMeshTolerance Normals NumSubEdges OCCAutoFix OCCAutoEmbed",
        "OCCBooleanPreserveNumbering OCCBoundsUseStl OCCFixDegenerated OCCFixSmallEdges OCCFixSmallFaces OCCMakeSolids",
        "OCCParallel OCCScaling OCCSewFaces OCCUnionUnify OCCUseGenericClosestPoint OffsetX OffsetY OffsetZ OldCircle",
        "OldNewreg OldRuledSurface PointLabels PointNumbers PointSize Points ReparamOnFaces ScalingFactor SnapX SnapY",
        "SnapZ SurfaceLabels SurfaceNumbers SurfaceType Surfaces Tangents Tolerance ToleranceBoolean Transform",
        "VolumeLabels VolumeNumbers Volumes",
    ),
    "Mesh": _words(
        "Algorithm Algorithm3D AlgorithmSwitchOnFailure AllowSwapAngle AngleSmoothNormals AngleToleranceFacetOverlap",
        "AnisoMax Binary BoundaryLayerFanElements BoundaryLayerFanPoints CharacteristicLengthExtendFromBoundary",
        "CharacteristicLengthFactor CharacteristicLengthFromCurvature CharacteristicLengthFromPoints",
        "CharacteristicLengthFromParametricPoints CharacteristicLengthMax CharacteristicLengthMin ColorCarousel",
        "CompoundCharacteristicLengthFactor CompoundClassify CompoundMeshSizeFactor ElementOrder FlexibleTransfinite",
        "Format HighOrderOptimize LabelType LcIntegrationPrecision Light LineNumbers LineWidth Lines",
        "MaxIterDelaunay3D MaxNumThreads1D MaxNumThreads2D MaxNumThreads3D MeshSizeExtendFromBoundary MeshSizeFactor",
        "MeshSizeFromCurvature MeshSizeFromCurvatureIsotropic MeshSizeFromParametricPoints MeshSizeFromPoints",
        "MeshSizeMax MeshSizeMin MinimumCirclePoints MinimumCurveNodes MinimumCurvePoints MinimumElementsPerTwoPi",
        "MshFileVersion NewtonConvergenceTestXYZ NodeNumbers Nodes NumSubEdges Optimize OptimizeNetgen",
        "OptimizeThreshold PointNumbers PointSize Points QualityType RandomFactor RandomFactor3D RandomSeed",
        "RecombinationAlgorithm Recombine3DAll RecombineAll RecombineOptimizeTopology RefineSteps Renumber SaveAll",
        "SaveGroupsOfElements SaveGroupsOfNodes SaveParametric SaveTopology SecondOrderIncomplete SecondOrderLinear",
        "SmoothNormals SmoothRatio Smoothing SubdivisionAlgorithm SurfaceEdges SurfaceFaces SurfaceNumbers",
        "ToleranceEdgeLength ToleranceInitialDelaunay ToleranceReferenceElement TransfiniteTri Triangles Tetrahedra",
        "VolumeEdges VolumeFaces VolumeNumbers",
    ),
}
"""Options for meshes and pictures. All of them are numbers; none is a file or a program."""

FACTORIES = ("OpenCASCADE", "Built-in", "Gmsh")

REFUSED = _words(
    # words of the parser
    "Abort AbsolutePath AdaptMesh Alias AliasWithOptions Append Betti ClassifySurfaces CodeName Cohomology Color",
    "ColorTable Combine Coordinates CopyOptions Cpu CreateGeometry CreateMeshEdges CreateMeshFaces CreateTopology",
    "CurrentDir CurrentDirectory CurrentFileName DefineNumber DefineString Degenerated DimNameSpace DirName Draw",
    "Ellipsoid Elliptic Error Euclidean Euclidian Exit FileExists FixRelativePath GetEnv GetForced GetForcedStr",
    "GetNumber GetString GetStringValue GetValue GmshExecutableName Homology INTERPOLATION_SCHEME Levelset",
    "ListFromFile LowerCase LowerCaseIn MPI_Rank MPI_Size Memory N2S NameStruct NameToString NewModel OnelabAction",
    "OnelabRun Plugin Printf QuadTriAddVerts QuadTriaddVerts QuadtriAddVerts QuadtriaddVerts QuadTriAddverts",
    "QuadTriaddverts QuadtriAddverts Quadtriaddverts QuadTriNoNewVerts QuadTriNonewVerts QuadTrinoNewVerts",
    "QuadTrinonewVerts QuadtriNoNewVerts QuadtriNonewVerts QuadtrinoNewVerts QuadtrinonewVerts QuadTriNoNewverts",
    "QuadTriNonewverts QuadTrinoNewverts QuadTrinonewverts QuadtriNoNewverts QuadtriNonewverts QuadtrinoNewverts",
    "Quadtrinonewverts Quadric RecombLaterals Recomblaterals RecombineMesh RefineMesh RelocateMesh",
    "RenumberMeshElements RenumberMeshNodes ReorientMesh S2N SetChanged SetMaxTag SetNumber SetPartition SetString",
    "SetTag ShapeFromFile Slide StrChoice StrCmp StrFind StrLen StrPrefix StrRelative StrReplace StrSub StringToName",
    "Struct SyncModel T2 T3 TIME TestLevel TextAttributes Today TotalMemory TransfQuadTri TransfQuadtri TransfquadTri",
    "Transfquadtri TransformMesh UndefineConstant UnsplitWindow UpperCase Warning",
    # commands that the parser knows by their names only
    "SystemCall System NonBlockingSystemCall Include Merge MergeWithBoundingBox MergeFile Open Save SaveAs Print",
    "CreateDir Sleep Remesh PartitionMesh SetOrder OptimizeMesh SetName SendToServer CreateOverlaps SetCurrentWindow",
    "SplitCurrentWindowHorizontal SplitCurrentWindowVertical View Views PostView ExternalProcess CommandLine Mesh",
    "General Geometry Solver PostProcessing OnelabParameters",
)
"""Words with a special meaning for Gmsh that are not needed here."""
