"""Public names, loaded on first use."""

from ._charts import (
    acceleration_map as acceleration_map,
    duration_line as duration_line,
    front as front,
    prices as prices,
    reserve as reserve,
    sparsity as sparsity,
)
from ._curves import Curve as Curve, curves as curves
from ._design import design as design
from ._limits import limit_use as limit_use, saturation as saturation
from ._motion import (
    cell as cell,
    comparison as comparison,
    motion as motion,
    tracking as tracking,
)
from ._page import (
    SCREEN_DPI as SCREEN_DPI,
    AxesGrid as AxesGrid,
    figure_of as figure_of,
    halo as halo,
    save as save,
    styled as styled,
    write as write,
)
from ._paths import arms as arms, paths as paths
from ._phase_plane import phase_plane as phase_plane
from ._report import report as report, report_figure as report_figure
from ._solution import solution as solution
from ._sweep import sweep as sweep
