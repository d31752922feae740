// Three blocks on each other, the middle one wider to the right. Mesh with Gmsh: gmsh -2 stack.geo
h = 0.08;
Point(1) = {0, 0, 0, h}; Point(2) = {2, 0, 0, h}; Point(3) = {2, 0.5, 0, h}; Point(4) = {0, 0.5, 0, h};
Point(5) = {2, 1, 0, h}; Point(6) = {0, 1, 0, h}; Point(7) = {1.2, 1, 0, h};
Point(8) = {1.2, 1.5, 0, h}; Point(9) = {0, 1.5, 0, h};
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4}; Line(4) = {4, 1};
Line(5) = {3, 5}; Line(6) = {5, 7}; Line(7) = {7, 6}; Line(8) = {6, 4};
Line(9) = {7, 8}; Line(10) = {8, 9}; Line(11) = {9, 6};
Curve Loop(1) = {1, 2, 3, 4};  Plane Surface(1) = {1};
Curve Loop(2) = {-3, 5, 6, 7, 8}; Plane Surface(2) = {2};
Curve Loop(3) = {-7, 9, 10, 11}; Plane Surface(3) = {3};
Physical Curve("floor") = {1}; Physical Curve("free") = {2, 4, 5, 6, 8, 9, 11};
Physical Curve("low") = {3}; Physical Curve("high") = {7}; Physical Curve("top") = {10};
Physical Surface("one") = {1}; Physical Surface("two") = {2}; Physical Surface("three") = {3};
