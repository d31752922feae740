// Half of a lap joint, in mm: the upper plate from x = 0 to 50, the lower one from 20 to 70, each 5 thick and half of 24
// wide, with a hole for a bolt around x = 35. Rings on top and below are where washer and head of the bolt press.
// Mesh with Gmsh: gmsh -3 joint.geo
SetFactory("OpenCASCADE");
hole = 3; ring = 7; e = 0.01;
Box(1) = {0, 0, 0, 50, 12, 5};
Box(2) = {20, 0, -5, 50, 12, 5};
Cylinder(3) = {35, 0, -6, 0, 0, 12, hole};
BooleanDifference{ Volume{1, 2}; Delete; }{ Volume{3}; Delete; }
Disk(1001) = {35, 0, 5, ring};
Disk(1002) = {35, 0, -5, ring};
BooleanFragments{ Volume{1, 2}; Delete; }{ Surface{1001, 1002}; Delete; }
all() = Abs(CombinedBoundary{ Volume{1, 2}; });
joint() = Surface In BoundingBox{20 - e, -e, -e, 50 + e, 12 + e, e};
washer() = Surface In BoundingBox{35 - ring - e, -e, 5 - e, 35 + ring + e, ring + e, 5 + e};
head() = Surface In BoundingBox{35 - ring - e, -e, -5 - e, 35 + ring + e, ring + e, -5 + e};
pulled() = Surface In BoundingBox{-e, -e, -e, e, 12 + e, 5 + e};
held() = Surface In BoundingBox{70 - e, -e, -5 - e, 70 + e, 12 + e, e};
symmetry() = Surface In BoundingBox{-e, -e, -5 - e, 70 + e, e, 5 + e};
Physical Surface("joint") = joint();   Physical Surface("washer") = washer();
Physical Surface("head") = head();     Physical Surface("pulled") = pulled();
Physical Surface("held") = held();     Physical Surface("symmetry") = symmetry();
all() -= washer(); all() -= head(); all() -= pulled(); all() -= held(); all() -= symmetry();
Physical Surface("free") = all();
Physical Volume("upper") = {1}; Physical Volume("lower") = {2};
Mesh.MeshSizeFromCurvature = 8; Mesh.MeshSizeMax = 6;
