// The upper left quarter of a channel of half width 2 around a cylinder of radius 1
near = 0.05; far = 0.3;
Point(1) = {-6, 0, 0, far}; Point(2) = {-1, 0, 0, near}; Point(3) = {0, 1, 0, near}; Point(4) = {0, 2, 0, near}; Point(5) = {-6, 2, 0, far};
Point(6) = {0, 0, 0};
Line(1) = {1, 2}; Circle(2) = {2, 6, 3}; Line(3) = {3, 4}; Line(4) = {4, 5}; Line(5) = {5, 1};
Curve Loop(1) = {1, 2, 3, 4, 5}; Plane Surface(1) = {1};
Physical Curve("axis") = {1}; Physical Curve("cylinder") = {2}; Physical Curve("middle") = {3};
Physical Curve("wall") = {4}; Physical Curve("inlet") = {5};
Physical Surface("fluid") = {1};
