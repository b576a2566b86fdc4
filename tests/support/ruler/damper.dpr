[MDI_HEADER]
FILE_TYPE = 'dpr'
[UNITS]
LENGTH = 'mm'
FORCE = 'newton'
TIME = 'sec'
[CURVE]
{ vel force }
-1000 -1200
-300 -500
-50 -110
0 0
50 130
300 700
1000 1900
