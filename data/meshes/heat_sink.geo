// A base 40 wide and 4 high with five fins, each 2 wide and 20 high
Point(1) = {-20, 0, 0, 1.5}; Point(2) = {20, 0, 0, 1.5};
For i In {0 : 4}
  x = 20 - 9.5 * i;
  Point(4 * i + 3) = {x, 4, 0, 1.5}; Point(4 * i + 4) = {x, 24, 0, 1.5};
  Point(4 * i + 5) = {x - 2, 24, 0, 1.5}; Point(4 * i + 6) = {x - 2, 4, 0, 1.5};
EndFor
For i In {1 : 21}
  Line(i) = {i, i + 1};
EndFor
Line(22) = {22, 1};
Curve Loop(1) = {1 : 22}; Plane Surface(1) = {1};
Physical Curve("base") = {1}; Physical Curve("air") = {2 : 22};
Physical Surface("sink") = {1};
