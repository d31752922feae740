// The right half of a block below y = 0
Point(1) = {0, 0, 0, 0.8}; Point(2) = {14, 0, 0, 0.8}; Point(3) = {100, 0, 0, 20}; Point(4) = {100, -200, 0, 25}; Point(5) = {0, -200, 0, 25};
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4}; Line(4) = {4, 5}; Line(5) = {5, 1};
Curve Loop(1) = {1, 2, 3, 4, 5}; Plane Surface(1) = {1};
Physical Curve("face") = {1}; Physical Curve("rest") = {2, 3}; Physical Curve("bottom") = {4}; Physical Curve("axis") = {5};
Physical Surface("block") = {1};
