// A square of side 1 around a cylinder with a tenth of its area
a = Sqrt(0.1/Pi); near = 0.03; far = 0.08;
Point(1) = {-0.5, -0.5, 0, far}; Point(2) = {0.5, -0.5, 0, far}; Point(3) = {0.5, 0.5, 0, far}; Point(4) = {-0.5, 0.5, 0, far};
Point(5) = {0, 0, 0}; Point(6) = {a, 0, 0, near}; Point(7) = {0, a, 0, near}; Point(8) = {-a, 0, 0, near}; Point(9) = {0, -a, 0, near};
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4}; Line(4) = {4, 1};
Circle(5) = {6, 5, 7}; Circle(6) = {7, 5, 8}; Circle(7) = {8, 5, 9}; Circle(8) = {9, 5, 6};
Curve Loop(1) = {1, 2, 3, 4}; Curve Loop(2) = {5, 6, 7, 8}; Plane Surface(1) = {1, 2};
Physical Curve("bottom") = {1}; Physical Curve("right") = {2}; Physical Curve("top") = {3}; Physical Curve("left") = {4};
Physical Curve("cylinder") = {5, 6, 7, 8};
Physical Surface("fluid") = {1};
