// Half of a lap joint, in mm: the upper plate from x = 0 to 50, the lower one from 20 to 70, each 5 thick and half of 24
// wide, with a hole for a bolt around x = 35. Rings on top and below are where washer and head of the bolt press.
SetFactory("OpenCASCADE");
hole = 3; ring = 7;
Box(1) = {0, 0, 0, 50, 12, 5};
Box(2) = {20, 0, -5, 50, 12, 5};
Cylinder(3) = {35, 0, -6, 0, 0, 12, hole};
BooleanDifference{ Volume{1, 2}; Delete; }{ Volume{3}; Delete; }
Disk(1001) = {35, 0, 5, ring};
Disk(1002) = {35, 0, -5, ring};
BooleanFragments{ Volume{1, 2}; Delete; }{ Surface{1001, 1002}; Delete; }
Recursive Delete { Surface{:}; }
Mesh.MeshSizeMin = 2; Mesh.MeshSizeMax = 6;
