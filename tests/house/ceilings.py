"""The ceilings of each capability: the lines of source, tests and docs that it may have.

`python -m tests.house.ceilings` prints the present lines of each row. `--lower` writes them into this file where they are fewer,
`--set` in any case. A commit that raises a ceiling gives the reason in its message.

A row is a capability and its ceilings. The globs of its files follow: `*` matches within a folder, `**` across folders, `{a,b}`
one of two names. Code and text count (`SUFFIXES`). Vehicle files, MJCF, published data and pictures do not: more are welcome.
"""

import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

ROOT = Path(__file__).parents[2]
FOLDERS = ("models", "synth", "sim", "tests", "docs")
SUFFIXES = frozenset((".py", ".c", ".h", ".css", ".js", ".mjs", ".jinja", ".md"))
SKIPPED = re.compile(r".*__pycache__/.*|docs/((_build|reference)/.*|(gallery|examples|tutorials/notebook)\.md)")  # generated
COLUMNS = ("source", "tests", "docs")

TABLE = """
what all commands share: files, options, checks, tables of numbers   3588   2328      0
    models/common/* tests/*/test_{children,columns,files,interrupts*,loaded,messages,portable}.py tests/models/test_sections.py
    tests/*/test_{json_keys,printed,progress,roadproof,shell,tables,wrong_calls,bad_input*}.py
    tests/commands/golden.py
vehicle file, types, equations, MJCF                           6661   2064    345
    models/{README.md,__init__.py,full_car.py,half_car*.py,quarter_car.py} sim/new.py
    models/laws/{__init__,design_request,law,linear}.py
    models/kinds/{__init__,car,kind,linear_model,motion,plausibility,rigid_body,rigid_motion,seat*,signals,strut_and_tyre}.py
    models/vehicle/{__init__,controller*,file_schema,limits_and_implementation,mjcf,names,payload,performance,sketch,vehicle}.py
    tests/*/test_{cars,heights,mjcf,new,on_demand,seat,sketch,units,vehicle_file,written_units}.py
    docs/tutorials/your-own-car.md docs/how-to/{limits-and-actuators,new,seat,vehicle-data}.md
laws and families in files                                      299    354    111
    models/vehicle/{in_place,*_file}.py tests/*/test_{law_files,toml}.py docs/how-to/import-controllers.md
foreign FMU as a controller                                     171    202      0
    models/vehicle/*fmu*.py tests/models/test_foreign_fmu.py
laws in Python                                                  832    706    107
    models/laws/{python_law,python_runtime,user_code}.py sim/drive/drivers/python.py tests/models/test_python_laws.py
    docs/how-to/python-control-laws.md tests/claims/test_any_controller.py
custom vehicle types                                            224    415    130
    models/kinds/user_kind.py tests/*/test_own_*.py docs/how-to/custom-vehicle-type.md
semi-active dampers and laws                                   1435    743    206
    models/parts/{adjustable,damper_range}.py models/characteristics/adjustable_range.py models/laws/semi_active.py
    sim/drive/drivers/semi_active.py
    models/vehicle/semi_active_coefficients.py sim/linear/dampers.py sim/runs/dampers.py
    tests/*/test_measured_dampers.py tests/*/test_semi_active*.py
    docs/how-to/semi-active-dampers.md docs/tutorials/semi-active-damper.md
curves of dampers and springs, statistical linearisation       3744   1972    183
    models/characteristics/{__init__,curve*,measured_loop,ratio_table,surface*}.py
    models/parts/{characteristic,curves,damper,lines,plausibility,ratio,spring,surface_damper}.py
    sim/studies/ride/statistical_linearisation.py sim/linear/{nonlinear_elements,outputs,stepped}.py tests/sim/test_stepped.py
    sim/runs/force_diagram.py synth/controller/equivalent_line.py
    tests/support/curved.py tests/*/test_{curves*,motion_ratios,spring_tables,surfaces}.py
    tests/*/test_{damper_diagram,sharp_knots,statistical_linearisation}.py docs/how-to/{springs-and-dampers,force-elements}.md
bump stops                                                      662    167      0
    models/parts/stops/* sim/runs/stops.py tests/models/test_stops.py
parts of a suspension                                          2306   1972      0
    models/parts/{__init__,actuator,element,native,part,placement}.py models/vehicle/suspension_forces.py
    models/kinds/at_wheels.py sim/drive/part_steps.py tests/models/test_parts.py tests/sim/test_part_steps.py
    tests/support/mechanism.py tests/house/test_removal.py models/parts/elements/*.py models/parts/settable.py
    tests/models/test_set_voltages.py
loads, links, tyre damping                                      822   1442     57
    models/roads/loads/* models/kinds/links.py sim/runs/forces.py docs/how-to/suspension-kinematics.md
    tests/*/test_{acting,loads,tyre_damping,vehicle_options,weighed_loads}.py
measured roads, rigs, OpenCRG, IRI                             1501    988      0
    models/roads/{iri,opencrg,profile*,rig*}.py tests/*/test_{iri,measured_roads,rig}.py
analytic and random roads                                      1797    940    168
    models/roads/{__init__,choice,description,iso8608,obstacles,road,sinusoids,spectrum}.py
    tests/models/test_{roads,second_sources}.py docs/how-to/{custom-roads,roads}.md
preview, LQR, LQG, H2                                           711    625     52
    models/laws/preview.py sim/linear/preview_response.py synth/design/full_order/{preview,quadratic}.py
    tests/*/test_{preview,quadratic}.py docs/how-to/preview.md
anti-windup, integrals, compatible options                      523   1159      0
    models/laws/{anti_windup,combinations}.py models/vehicle/weights.py synth/controller/integral_action.py
    tests/support/pairs.py tests/*/test_{anti_windup,integrals,pairs,windup}.py
fixed order, PI, PID                                            914    332      0
    models/laws/law_structure.py synth/design/fixed_order/* tests/synth/test_fixed_order.py
goals, families, trade-off front                               3871   1559    132
    models/laws/goals.py synth/design/multi_objective/* synth/design/multi_model.py synth/vehicle/trade_off/*
    synth/vehicle/{multi_objective,verification}.py synth/command/trade_off.py
    tests/support/goals.py tests/*/test_{band,energy_limits,family,front,goals*}.py
    docs/how-to/{goals,trade-off}.md docs/explanation/how-goals-are-proved.md
uncertainty: fragility, mu, boxes                              2511    935     65
    synth/design/uncertainty/* synth/analysis/uncertainty_box.py synth/lmi/{least_unknown,stacked_barrier}.py
    synth/command/fragility.py
    {models/laws,synth/vehicle}/weighted_errors.py
    tests/*/test_{fragility,multipliers,tolerance,weighted_errors}.py
    docs/how-to/robustness.md
sampled data: norm, bound, designs, rates                      2223   1235     88
    synth/analysis/sampled_*.py synth/design/sampled_data.py synth/lmi/sampled_bound.py
    synth/vehicle/sample_rate/* synth/command/sample_rate.py synth/controller/implementation_norm.py
    tests/*/test_{sampled_*}.py docs/how-to/sampled-data-design.md
export: C99, fixed point, FMI, MATLAB                          3450   1452    112
    synth/controller/export/** synth/command/export*.py sim/drive/drivers/code.py
    sim/runs/code_effect.py tests/support/cortex_m4.py tests/*/test_{code_in_the_loop,export*}.py docs/how-to/{export,simulink}.md
full-order H-infinity                                           999    741    118
    synth/design/full_order/{__init__,full_order,riccati,stable}.py docs/how-to/dynamic-controllers.md
    tests/*/test_{full_order,named_designs,stable_law}.py
static search, descent, refine                                 2327    750      0
    synth/design/descent/* synth/design/{fallback,static}.py synth/vehicle/refined.py tests/support/multistart.py
    tests/*/test_{against_descents,descent,static}.py
LMI certificates that anybody can check                         963    351    115
    synth/analysis/lmi_certificate/* synth/vehicle/lmi_certificates.py synth/command/certificates.py
    tests/synth/test_lmi_certificates.py tests/support/check_certificates.mjs docs/explanation/lmi-certificates.md
two steps, LMI path                                            2839   1013    144
    synth/design/{__init__,degenerate,two_step}.py synth/vehicle/paper.py synth/command/cross_check.py
    tests/support/active_suspension.py
    synth/lmi/{__init__,barrier,central_path,full_order_bound,output_nulling,sdp,structured_barrier,un*}.py
    tests/*/test_{central,paper,slicot,structured,two_steps_of_any_plant}.py
    docs/explanation/{control-problem,reproduce-the-paper}.md
certificates, norms, lower bounds                              3706   2295     45
    synth/analysis/{__init__,band_norm,bounding,certificate,energy_to_peak,norm,record,rigorous,specification,stabilisability,stability,twice_precision}.py
    synth/analysis/lower_bounds/* synth/command/check.py tests/support/exactly.py
    tests/*/test_{certificate,exact_proofs,false_certificates,lower_bound,no_controller*,noise,norm,stability,zeros}.py
    docs/explanation/bound-norm-lower-bound.md
plant algebra, filters, any plant                              3332   2133    330
    synth/plant/* models/laws/{design_methods,filter,iso2631}.py synth/design/{feedback,methods,problem}.py
    synth/vehicle/state_space.py
    tests/support/weighted.py
    tests/*/test_{any_plant,convert,design,design_feedback,discrete,filters,loop,methods,state_space,weights}.py
    docs/how-to/{any-linear-plant,weights,when-hinfsyn-fails}.md
synth command, controller record, designer                     3793    660    180
    synth/{README.md,__init__.py,__main__.py} synth/command/{__init__,design_table,options,responses,save,table}.py
    synth/controller/{__init__,controller,design_notes,filtered_plant,law_margins,loop_of,measured_heights}.py
    synth/controller/{problem,report,sampled_report}.py
    synth/vehicle/{__init__,certified_vehicle,design_problem,designer,expected_ride,mean_square}.py
    tests/*/test_{law_warnings,synth_command}.py docs/how-to/synth.md
log re-verification                                             965    580     43
    sim/inspect/* tests/support/rewriting.py tests/claims/test_inspect.py docs/how-to/inspect.md
recordings: MCAP, Foxglove, Rerun                              2391   1142     42
    sim/recording/* sim/command/viewer.py tests/*/{npm.py,mcap_reader.mjs} docs/how-to/record-and-view.md
    tests/*/test_{foxglove,law_states,recording,rerun,viewer}.py
page and figures                                               3805   1381     69
    sim/report/* models/document/* tests/*/{reading.py,page_in_browser.mjs} tests/*/test_{beside,page,page_in_browser,report*}.py
    docs/how-to/report.md docs/tutorials/reading-a-report.md
campaigns                                                      3128   1801    189
    sim/campaign/* sim/runs/sampled_vehicle.py tests/*/test_{best,campaign*,cluster,trade_off}.py docs/how-to/campaign.md
    docs/how-to/tune-a-law.md
studies: one noun for commands and the page                     477      0      0
    sim/command/study.py sim/studies/{command_name,study,subject}.py
gallery of papers                                               785    343     49
    sim/gallery.py sim/studies/gallery/* models/gallery/** tests/claims/test_gallery.py
    docs/explanation/verification.md
margins in physics                                             2220    823     75
    sim/margins.py sim/studies/stability/* tests/*/test_margins*.py docs/how-to/margins.md
    synth/controller/{disk_margin,sample_period_margin,stability_margins}.py
recommendation of a controller                                 1699    400    202
    sim/studies/recommend/* tests/sim/test_recommend.py
    docs/how-to/{recommend,sensors-and-controllers}.md docs/tutorials/best-controller.md
frequency, sweep                                               2213    617     37
    sim/sweep.py sim/studies/frequency/* tests/*/test_{eusama,sweep*}.py docs/how-to/sweep.md
ride metrics and their expectation                             3453   1288      0
    sim/studies/{__init__,ride/__init__,ride/between_samples,ride/expected,ride/gaussian,ride/metrics,ride/quadrature}.py
    sim/studies/ride/{kinds/*,loads,over_roads,run_metrics,score*,step_response,weighting}.py
    tests/*/test_{expected*,metrics,midway,settled,scores,step_response}.py
measured logs beside runs                                       749    319     99
    models/common/logs/* sim/studies/validity/measured_log.py tests/*/test_measured_log*.py docs/how-to/measured-logs.md
identification from measured logs                              4504    732    265
    sim/identify.py sim/studies/identification/{*,estimation/*,spectra/*} tests/*/test_identify*.py docs/how-to/identify.md
    docs/tutorials/identify-a-car.md
map of validity                                                1367    371     33
    sim/envelope.py sim/studies/validity/{__init__,command,edges,grid,map_runs,re*,study}.py tests/sim/test_envelope.py
    docs/how-to/envelope.md
MuJoCo loop                                                    3058   1103      0
    sim/drive/{__init__,actuators,case,computer,drive,driver,loop,sensor_readout}.py
    sim/drive/drivers/{__init__,linear,recorded,registry}.py
    sim/observers/*
    tests/*/test_{drivers,energy,hardware,observers,reality,shares}.py
linear responses                                               1026    418      0
    sim/linear/{__init__,forced_response,frequency_response,linear_motion,prediction,response_batch,rounding}.py
    sim/linear/sampled_response.py tests/support/analysed.py tests/synth/test_laws.py
runs, verdict, their text                                      2881   1052    107
    sim/runs/{__init__,agreement,by_name,decay,re*,run,signal_table,start,time_histories}.py
    sim/drive/{jumps,recursion,regime,response}.py
    tests/support/faults.py tests/*/test_{agreement,drawn,faults,start,verdict}.py
    docs/explanation/{why-mujoco,not-modelled}.md
commands that drive                                            1177   1000    372
    sim/{README.md,__init__.py,__main__.py,bump.py} sim/drive/__main__.py
    tests/support/drives.py tests/*/test_{bump,drive,options,several}.py
    sim/command/{__init__,comparison,driv*,road_options}.py
    docs/how-to/{bump,drive,loads}.md docs/tutorials/first-bump.md
house, pages, benchmarks                                          0   5900   2486
    tests/{__init__,conftest,same_numbers}.py tests/house/sample.py
    tests/*/{__init__,ceilings,__main__,commands,formats,pages,prose,shared,sources}.py
    tests/*/test_{architecture,help_pages,house,pages,public,readme,recipes,ruler,sentences,shared,site}.py
    tests/benchmarks/* tests/evals/* tests/support/ruler/*
    tests/house/test_examples.py docs/examples/*.py
    docs/_static/* docs/*.{md,py} docs/{how-to,explanation,tutorials}/index.md docs/start/*.md
    docs/how-to/{analyse,deliver,design,simulate,vehicle}.md
"""


def counted(root: Path = ROOT) -> dict[str, int]:
    """Returns the lines of every file that counts, by its path from the root."""
    paths = [path for folder in FOLDERS for path in (root / folder).rglob("*") if path.suffix in SUFFIXES]
    names = sorted(name for path in paths if not SKIPPED.fullmatch(name := path.relative_to(root).as_posix()))
    return {name: (root / name).read_bytes().count(b"\n") for name in names}


def column_of(name: str) -> str:
    """Returns the column that a file counts in: pages are docs, wherever they are."""
    top = name.partition("/")[0]
    return top if top in COLUMNS else "docs" if name.endswith(".md") else "source"


def spelled(glob: str) -> Iterator[str]:
    """Yields a glob once for each of the names in its braces."""
    before, brace, rest = glob.partition("{")
    names, _, after = rest.partition("}")
    for name in names.split(",") if brace else ():
        yield from spelled(before + name + after)
    if not brace:
        yield glob


def expression(glob: str) -> str:
    """Returns the regular expression of a glob without braces."""
    return re.escape(glob).replace(r"\*\*", ".*").replace(r"\*", "[^/]*")


@dataclass(frozen=True)
class Row:
    """A capability, the lines that it may have by column, and the globs of its files."""

    capability: str
    ceilings: tuple[int, ...]
    globs: tuple[str, ...]

    @cached_property
    def _files(self) -> re.Pattern[str]:
        return re.compile("|".join(map(expression, self.globs)))

    def has(self, name: str) -> bool:
        """Returns True if a file belongs to the capability."""
        return bool(self._files.fullmatch(name))

    def lines(self, files: dict[str, int]) -> tuple[int, ...]:
        """Returns the lines of the row's files, by column."""
        own = [name for name in files if self.has(name)]
        return tuple(sum(files[name] for name in own if column_of(name) == column) for column in COLUMNS)

    def too_many(self, files: dict[str, int]) -> list[str]:
        """Returns the columns that are above their ceilings, in words."""
        columns = zip(COLUMNS, self.lines(files), self.ceilings, strict=True)
        return [f"{lines - most} lines of {column} too many" for column, lines, most in columns if lines > most]


def rows() -> list[Row]:
    """Returns the rows of the table."""
    found = re.findall(r"^(\S.*?) +(\d+) +(\d+) +(\d+)\n((?: +.*\n)+)", TABLE, re.MULTILINE)
    globs = [tuple(one for glob in row[-1].split() for one in spelled(glob)) for row in found]
    return [Row(row[0], tuple(map(int, row[1:4])), each) for row, each in zip(found, globs, strict=True)]


def written(capability: str, lines: tuple[int, ...]) -> str:
    """Returns the first line of a row."""
    return f"{capability:60}" + "".join(f"{n:7d}" for n in lines)


def main() -> int:
    """Prints the table, and writes ceilings if asked to; returns 1 if a row is above its ceiling."""
    files, text = counted(), Path(__file__).read_text(encoding="utf-8")
    now = {row: row.lines(files) for row in rows()}
    for row, lines in now.items():
        new = lines if "--set" in sys.argv else tuple(map(min, lines, row.ceilings))
        text = re.sub(rf"^{re.escape(row.capability)}( +\d+){{3}}$", written(row.capability, new), text, flags=re.MULTILINE)
    if {"--set", "--lower"} & {*sys.argv}:
        Path(__file__).write_text(text, encoding="utf-8", newline="\n")
    for row, lines in now.items():
        print(written(row.capability, lines), *row.too_many(files), sep="  ")
    print(written("total", tuple(map(sum, zip(*now.values(), strict=True)))))
    return int(any(row.too_many(files) for row in now))


if __name__ == "__main__":
    sys.exit(main())
