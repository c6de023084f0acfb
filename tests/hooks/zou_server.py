"""A real Kitsu server for one test: PostgreSQL, Redis and zou, in a folder of their own.

Wanted on the machine: PostgreSQL's and Redis's programs, and a Python with zou, which
USDFACE_ZOU_PYTHON names (zou pins so much that it wants an environment of its own).
"""

import contextlib
import os
import shutil
import socket
import subprocess
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path

LOGIN, PASSWORD = "td@example.com", "a-long-password"
SECONDS_TO_START = 120


def missing() -> str:
    """Return what the machine lacks; empty where nothing is."""
    python = os.environ.get("USDFACE_ZOU_PYTHON", "")
    if not python or not Path(python).exists():
        return "set USDFACE_ZOU_PYTHON to a Python that has zou"
    lacking = [name for name in ("redis-server",) if shutil.which(name) is None]
    return f"needs {', '.join(lacking)}" if lacking else "" if _postgres() else "needs PostgreSQL"


@contextlib.contextmanager
def running_zou(folder: Path) -> Iterator[str]:
    """Yield the URL of a server whose database is new and empty but for an administrator."""
    database, cache, web = _free_port(), _free_port(), _free_port()
    python = os.environ["USDFACE_ZOU_PYTHON"]
    environment = os.environ | {
        "DB_HOST": "127.0.0.1",
        "DB_PORT": str(database),
        "DB_USERNAME": "postgres",
        "DB_PASSWORD": "",
        "DB_DATABASE": "zoudb",
        "KV_HOST": "127.0.0.1",
        "KV_PORT": str(cache),
        "SECRET_KEY": "a-key-of-this-test-alone-and-long-enough",
        "PREVIEW_FOLDER": str(folder / "previews"),
        "TMP_DIR": str(folder / "tmp"),
        "ENABLE_JOB_QUEUE": "False",
        "MAIL_CHECK_DELIVERABILITY": "False",
        "PATH": f"{Path(python).parent}:{os.environ['PATH']}",
    }
    environment.pop("PYTHONPATH", None)
    started: list[subprocess.Popen[bytes]] = []
    try:
        started.append(_start_postgres(folder, database))
        started.append(
            _start(
                ["redis-server", "--port", str(cache), "--save", "", "--dir", str(folder)], folder
            )
        )
        _wait_for(database)
        _wait_for(cache)
        tool = _postgres()
        assert tool is not None
        connection = ["-h", "127.0.0.1", "-p", str(database), "-U", "postgres"]
        subprocess.run([tool / "createdb", *connection, "zoudb"], check=True)
        for command in (
            ["init-db"],
            ["init-data"],
            ["create-admin", LOGIN, "--password", PASSWORD],
        ):
            subprocess.run(
                [Path(python).with_name("zou"), *command],
                env=environment,
                check=True,
                capture_output=True,
            )
        serve = f"from zou.app import app; app.run(port={web}, threaded=True)"
        started.append(_start([python, "-c", serve], folder, environment))
        _wait_for(web)
        url = f"http://127.0.0.1:{web}"
        _wait_for_answer(url)
        yield url
    finally:
        for process in reversed(started):
            process.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(20)
            process.kill()
            process.wait()


def _postgres() -> Path | None:
    found = shutil.which("initdb")
    places = [Path(found).resolve().parent] if found else []
    places += sorted(Path("/usr/lib/postgresql").glob("*/bin"), reverse=True)
    return next((place for place in places if (place / "initdb").exists()), None)


def _start_postgres(folder: Path, port: int) -> subprocess.Popen[bytes]:
    tools = _postgres()
    assert tools is not None
    data = folder / "database"
    data.mkdir()
    # PostgreSQL refuses to run as root; everybody else runs it as they are.
    user = {"user": "postgres", "group": "postgres"} if os.geteuid() == 0 else {}
    if user:
        shutil.chown(data, **user)
        for parent in [folder, *folder.parents]:
            if parent.stat().st_uid == 0 and str(parent).startswith(str(folder.parents[2])):
                parent.chmod(parent.stat().st_mode | 0o055)
    initdb = [tools / "initdb", "-D", data, "-U", "postgres", "--auth=trust", "--no-sync"]
    subprocess.run(initdb, check=True, capture_output=True, cwd="/", **user)
    command = [tools / "postgres", "-D", data, "-p", str(port), "-k", data, "-c", "fsync=off"]
    return subprocess.Popen(
        command, cwd="/", stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, **user
    )


def _start(
    command: list[object], folder: Path, environment: dict[str, str] | None = None
) -> subprocess.Popen[bytes]:
    with (folder / "server.log").open("ab") as log:
        return subprocess.Popen(
            [str(word) for word in command], env=environment, cwd=folder, stdout=log, stderr=log
        )


def _free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])


def _wait_for(port: int) -> None:
    until = time.monotonic() + SECONDS_TO_START
    while time.monotonic() < until:
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 1):
            return
        time.sleep(0.2)
    raise TimeoutError(f"nothing listens at port {port}")


def _wait_for_answer(url: str) -> None:
    until = time.monotonic() + SECONDS_TO_START
    while time.monotonic() < until:
        with contextlib.suppress(OSError), urllib.request.urlopen(url, timeout=5) as answer:
            if answer.status == 200:
                return
        time.sleep(0.3)
    raise TimeoutError(f"{url} does not answer")
