// The lower right quarter of a cylinder of radius 50 whose lowest point is the origin
Point(1) = {0, 0, 0, 0.6}; Point(2) = {0, 50, 0, 8}; Point(3) = {50, 50, 0, 12}; Point(4) = {14, 2, 0, 0.6};
Circle(1) = {1, 2, 4}; Circle(2) = {4, 2, 3}; Line(3) = {3, 2}; Line(4) = {2, 1};
Curve Loop(1) = {1, 2, 3, 4}; Plane Surface(1) = {1};
Physical Curve("face") = {1}; Physical Curve("rest") = {2}; Physical Curve("top") = {3}; Physical Curve("axis") = {4};
Physical Surface("roller") = {1};
