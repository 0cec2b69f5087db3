from .bench.bench_file import load_bench as load_bench
from .bench.bench_session import open_session as open_session
from .bench.keep_out import KeepOut as KeepOut
from .bench.opened import open_bench as open_bench
from .errors import DaqError as DaqError
from .runner.photograph import photograph as photograph
