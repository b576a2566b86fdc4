"""C code in the loop.

Export a controller as C99 code. The compiled code then drives the vehicle in MuJoCo, and its forces are compared with
those of the controller itself. This example needs a C compiler.
"""

import subprocess
import sys
import tempfile

import matplotlib.pyplot as plt
import pandas as pd

bump = "sim.bump --controller I_printed --duration 1.5 --no-logs --csv"
with tempfile.TemporaryDirectory() as folder:
    for line in (f"{bump} law.csv", "synth --controller I_printed --export ecu", f"{bump} code.csv --as ecu"):
        subprocess.run([sys.executable, "-m", *line.split()], check=True, stdout=subprocess.DEVNULL, cwd=folder)
    law, code = pd.read_csv(f"{folder}/law.csv"), pd.read_csv(f"{folder}/code.csv")
[force] = [name for name in law.columns if name.startswith("control_force") and "mujoco" in name]
difference = (law[force] - code[force]).abs().max()
figure, axis = plt.subplots(figsize=(6, 3.8), layout="constrained")
axis.plot(law["time [s]"], law[force], "C7-", label="control law")
axis.plot(code["time [s]"][::40], code[force][::40], "C0o", label=f"C code, largest difference {difference:g} N")
axis.set(xlabel="time [s]", ylabel="control force [N]", title="Controller I_printed over the bump, as C code")
axis.legend()
figure.savefig("code_in_the_loop.png")
