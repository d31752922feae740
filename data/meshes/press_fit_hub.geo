// A quarter of a ring, from radius 2 to 3
Point(1) = {2, 0, 0}; Point(2) = {3, 0, 0}; Point(3) = {0, 3, 0}; Point(4) = {0, 2, 0}; Point(5) = {0, 0, 0};
Line(1) = {1, 2}; Circle(2) = {2, 5, 3}; Line(3) = {3, 4}; Circle(4) = {4, 5, 1};
Curve Loop(1) = {1, 2, 3, 4}; Plane Surface(1) = {1};
Physical Curve("along x") = {1}; Physical Curve("outer") = {2}; Physical Curve("along y") = {3}; Physical Curve("face") = {4};
Physical Surface("ring") = {1};
Mesh.MeshSizeMin = 0.2; Mesh.MeshSizeMax = 0.2;
