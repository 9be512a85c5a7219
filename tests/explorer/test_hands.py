"""The page on which tiles are corrected by hand: what its server does and refuses, and the page in Chromium."""

import base64
import http.client
import io
import json
import re
import signal
import socket
import struct
import subprocess
import sys
import zipfile
from contextlib import suppress
from pathlib import Path
from threading import Event, Thread

import cv2
import numpy as np
import photographed
import pytest
from explored import IN_BROWSER
from folders import files
from refusals import refused

from elitelanes_jax._util.errors import InputError
from elitelanes_jax.cli.main import main
from elitelanes_jax.explorer.serving import HandServer
from elitelanes_jax.photographs import Photograph, Proposal, cut_tiles, editing
from elitelanes_jax.photographs.cutting import mask_cut
from elitelanes_jax.photographs.editing import HandWork
from elitelanes_jax.tiles import inspect_tiles, load_tiles, propose_masks
from elitelanes_jax.tiles.masking import COLOURS
from elitelanes_jax.tiles.tileset import default_tiles

HERE = Path(__file__).parent


@pytest.fixture(scope="module")
def shot():
    return Photograph("floor.jpg", photographed.photograph(photographed.TOWN))


@pytest.fixture(scope="module")
def photographed_work(shot):
    """Work on a photograph; its folder is never written."""
    return HandWork(Path("never-written"), [shot], [(3, 3)])


@pytest.fixture
def tiles(tmp_path):
    """A small tile set with a file beside the tiles."""
    folder = tmp_path / "tiles"
    for kind in ("turn_1", "straight_1", "crossing3_1", "crossing4_1"):
        (folder / kind).mkdir(parents=True)
        for file in (default_tiles() / kind).iterdir():
            small = cv2.resize(cv2.imread(str(file), cv2.IMREAD_UNCHANGED), (96, 96), interpolation=cv2.INTER_NEAREST)
            cv2.imwrite(str(folder / kind / file.name), small)
    (folder / "tileset.toml").write_text('name = "mine"\n')
    (folder / "sheet.png").write_bytes(b"old")
    return folder


def unpacked(text, side):
    bits = np.unpackbits(np.frombuffer(base64.b64decode(text), np.uint8), count=side * side)
    return bits.reshape(side, side) > 0


def packed(mask):
    return base64.b64encode(np.packbits(mask)).decode()


def test_a_photograph_is_fitted_and_cut_as_the_command_does_it(photographed_work, shot):
    state = json.loads(json.dumps(photographed_work.state()))
    (start,) = state["photographs"]
    proposal = start["proposal"]
    assert (start["rows"], start["columns"], state["tiles"]) == (3, 3, [])
    corners = (np.array(proposal["corners"]) + 4).tolist()
    request = {"photo": 0, "corners": corners, "rows": 3, "columns": 3}
    exact = photographed_work.fit(request | {"exact": True})
    np.testing.assert_allclose(exact["corners"], corners, atol=0.01)
    cuts = cut_tiles(shot, Proposal(**proposal))
    served = photographed_work.cut({"photo": 0, "proposal": proposal})
    assert [tile["name"] for tile in served] == [cut.name for cut in cuts]
    for tile, cut in zip(served, cuts, strict=True):
        picture = cv2.imdecode(np.frombuffer(photographed_work.picture(tile["id"]), np.uint8), cv2.IMREAD_COLOR)
        np.testing.assert_array_equal(picture[..., ::-1], cut.image)
        for name, mask in mask_cut(cut).items():
            np.testing.assert_array_equal(unpacked(tile["masks"][name], 128), mask)
    colours = {name: [list(pair) for pair in colour] for name, colour in COLOURS.items()}
    colours["road"][2] = [0, 60]
    bits = photographed_work.mask({"id": served[0]["id"], "mask": "road", "colours": colours})
    expected = propose_masks(cuts[0].image, COLOURS | {"road": COLOURS["road"]._replace(value=(0, 60))})
    np.testing.assert_array_equal(unpacked(bits, 128), expected["road"])
    # A tile of another kind is cut as that kind.
    proposal["codes"][1][1] = 15
    assert "crossing4_1" in [tile["name"] for tile in photographed_work.cut({"photo": 0, "proposal": proposal})]


def test_wrong_requests_are_refused(photographed_work):
    request = {"photo": 0, "corners": [[9, 9], [8, 500], [500, 500], [500, 9]], "rows": 3, "columns": 3, "exact": True}
    with refused("floor.jpg: corners", "them counter-clockwise"):
        photographed_work.fit(request)
    with refused("", "0 and 3", expected="1 to 40"):
        photographed_work.fit(request | {"rows": 0})
    proposal = photographed_work.state()["photographs"][0]["proposal"]
    with refused("floor.jpg", "one for 5 x 640"):
        photographed_work.cut({"photo": 0, "proposal": proposal | {"width": 5}})
    with refused("", "none"):
        photographed_work.save([])


@pytest.mark.parametrize("name", ["turn_../../other", "turn_", "turn_1/x"])
def test_a_tile_has_a_name_that_a_set_reads(name, tiles):
    """A page's name is no path of a folder."""
    work = HandWork(tiles, [], [])
    values = work.state()["tiles"]
    values[0]["name"] = name
    assert work.save(values)["names"][0] == "turn_1"
    assert {tile.name for tile in load_tiles(tiles).tiles} == {"turn_1", "straight_1", "crossing3_1", "crossing4_1"}


def test_a_set_is_saved_whole_and_the_earlier_one_is_kept(tiles):
    before = files(tiles)
    work = HandWork(tiles, [], [])
    values = [{name: tile[name] for name in ("id", "name", "kind", "masks")} for tile in work.state()["tiles"]]
    assert [tile["name"] for tile in values] == ["turn_1", "straight_1", "crossing3_1", "crossing4_1"]
    yellow = unpacked(values[1]["masks"]["yellow"], 96)
    yellow[40:44, 20:24] = True
    values[1]["masks"]["yellow"] = packed(yellow)
    answer = work.save(values)
    assert answer["names"] == ["turn_1", "straight_1", "crossing3_1", "crossing4_1"]
    assert Path(answer["kept"]).name == "tiles.before" and files(Path(answer["kept"])) == before
    after = files(tiles)
    assert (tiles / "tileset.toml").read_text() == 'name = "mine"\n' and "sheet.png" not in after
    for tile in load_tiles(tiles).tiles:
        assert after[f"{tile.name}/image.png"] == before[f"{tile.name}/image.png"]
    saved = next(tile for tile in load_tiles(tiles).tiles if tile.name == "straight_1")
    np.testing.assert_array_equal(saved.yellow, yellow)
    # The second time, nothing more is set aside: the page wrote what it replaces.
    assert work.save(values[1:])["kept"] is None
    assert not (tiles / "turn_1").exists()
    assert {folder.name for folder in tiles.parent.iterdir()} == {"tiles", "tiles.before"}


def test_a_tile_of_another_kind_gets_the_next_name(tiles):
    work = HandWork(tiles, [], [])
    values = work.state()["tiles"]
    values[0]["kind"] = "straight"
    values[1]["name"] = values[2]["name"]
    values[1]["kind"] = values[2]["kind"]
    assert work.save(values)["names"] == ["straight_1", "crossing3_1", "crossing3_2", "crossing4_1"]
    assert any("straight_1" in problem and "road" in problem for problem in inspect_tiles(tiles)[1])


def test_a_set_that_another_program_changed_and_bad_masks_are_not_written(tiles):
    work = HandWork(tiles, [], [])
    values = work.state()["tiles"]
    bad = [values[0] | {"masks": values[0]["masks"] | {"red": packed(np.zeros(9, bool))}}, *values[1:]]
    before = files(tiles)
    with refused("", "2 bytes", expected="96 x 96"):
        work.save(bad)
    assert files(tiles) == before
    (tiles / "turn_1" / "red.png").write_bytes((tiles / "turn_1" / "road.png").read_bytes())
    before = files(tiles)
    with refused(tiles, "another program changed it"):
        work.save(values)
    assert files(tiles) == before


def test_the_earlier_set_is_copied_once(tiles):
    """Each save that failed left another copy."""
    work = HandWork(tiles, [], [])
    values = work.state()["tiles"]
    bad = [values[0] | {"masks": values[0]["masks"] | {"red": packed(np.zeros(9, bool))}}]
    for _ in range(2):
        with refused("", "2 bytes", expected="96 x 96"):
            work.save(bad)
    assert work.save(values)["kept"] == str(tiles.parent / "tiles.before")
    assert {folder.name for folder in tiles.parent.iterdir()} == {"tiles", "tiles.before"}


def test_two_saves_at_once_do_not_take_each_other_for_another_program(tiles, monkeypatch):
    work = HandWork(tiles, [], [])
    values = work.state()["tiles"]
    stamp_of, errors, threads = editing._stamp_of, [], []

    def save():
        try:
            work.save(values)
        except InputError as error:
            errors.append(str(error))

    def begin_another_save_after_writing(folder):
        stamp = stamp_of(folder)
        if stamp != work._stamp and not threads:
            threads.append(Thread(target=save))
            threads[0].start()
            threads[0].join(timeout=1)  # it has refused the folder, or waits
        return stamp

    monkeypatch.setattr(editing, "_stamp_of", begin_another_save_after_writing)
    work.save(values)
    threads[0].join()
    assert errors == []


def test_masks_that_the_sliders_would_replace_are_named(tiles):
    yellow = cv2.imread(str(tiles / "straight_1" / "yellow.png"), cv2.IMREAD_GRAYSCALE)
    for tile in load_tiles(tiles).tiles:
        for name, mask in propose_masks(tile.image).items():
            cv2.imwrite(str(tiles / tile.name / f"{name}.png"), mask.astype(np.uint8) * 255)
    yellow[:4, :4] = 255
    cv2.imwrite(str(tiles / "straight_1" / "yellow.png"), yellow)
    work = HandWork(tiles, [], [])
    values = work.state()["tiles"]
    others = [(tile["name"], mask) for tile in values for mask, same in tile["by_colours"].items() if not same]
    assert others == [("straight_1", "yellow")]
    # A page that is loaded again begins with what was saved.
    road = unpacked(values[0]["masks"]["road"], 96)
    road[40:50, 40:50] = False
    values[0]["masks"]["road"] = packed(road)
    work.save(values)
    again = work.state()["tiles"]
    assert [tile["masks"] for tile in again] == [tile["masks"] for tile in values]
    assert not again[0]["by_colours"]["road"] and again[0]["by_colours"]["yellow"]


def test_a_zip_has_the_set_and_leaves_the_folder_as_it_is(tiles, tmp_path):
    before = files(tiles)
    work = HandWork(tiles, [], [])
    values = work.state()["tiles"]
    values[0]["kind"] = "straight"
    content = work.zip(values)
    assert files(tiles) == before and not work.saved and list(tmp_path.iterdir()) == [tiles]
    zipfile.ZipFile(io.BytesIO(content)).extractall(tmp_path / "unpacked")
    work.save(values)
    assert files(tmp_path / "unpacked" / "tiles") == files(tiles)
    with refused("", "none"):
        work.zip([])


@pytest.fixture
def server(tiles):
    with HandServer(HandWork(tiles, [], [])) as server:
        thread = Thread(target=server.serve_forever)
        thread.start()
        yield server
        server.shutdown()
        thread.join()


def asked(server, path, *, body=None, **headers):
    """Sends a request; returns the status and the content."""
    connection = http.client.HTTPConnection("127.0.0.1", server.server_address[1], timeout=20)
    headers = {name.replace("_", "-"): value for name, value in headers.items()}
    if body is not None:
        headers = {"Content-Type": "application/json"} | headers
    connection.request("GET" if body is None else "POST", path, body, headers)
    answer = connection.getresponse()
    content = answer.read()
    connection.close()
    return answer.status, content


def test_the_server_answers_its_own_page_alone(server, tiles):
    before = files(tiles)
    root, port = f"/{server.token}/", server.server_address[1]
    assert server.server_address[0] == "127.0.0.1"
    assert asked(server, root)[0] == 200
    status, content = asked(server, root + "state", Host=f"localhost:{port}")
    assert status == 200 and len(json.loads(content)["tiles"]) == 4
    tile = json.loads(content)["tiles"][0]["id"]
    assert asked(server, f"{root}pictures/{tile}")[1][:4] == b"\x89PNG"
    save = json.dumps(json.loads(content)["tiles"])
    ours = f"http://127.0.0.1:{port}"
    for code, path, headers in (
        (403, "/", {}),
        (403, "/state", {}),
        (403, f"/{server.token[:-1]}/state", {}),
        (403, root + "save", {"body": save, "Host": "evil.example"}),
        (403, root + "save", {"body": save, "Host": f"evil.example:{port}"}),
        (403, root + "save", {"body": save, "Origin": "https://evil.example"}),
        (403, root + "save", {"body": save, "Origin": "null"}),
        (403, "/wrong/save", {"body": save, "Origin": ours}),
        (404, root + "save", {"body": save, "Content_Type": "text/plain"}),
        (404, root + "other", {"body": save}),
        (404, root + "pictures/other", {}),
        (404, root + "photographs/0", {}),
        (404, root + "../../etc/passwd", {}),
        (400, root + "save", {"body": "{"}),
        (400, root + "save", {"body": "[5]"}),
        (422, root + "save", {"body": "[]"}),
    ):
        status, content = asked(server, path, **headers)
        assert status == code and list(json.loads(content)) == ["error"], (path, headers)
    for length in (2**40, "9" * 5000):
        assert asked(server, root + "save", body="[]", Content_Length=str(length))[0] == 413
    assert files(tiles) == before
    assert asked(server, root + "save", body=save, Origin=ours)[0] == 200
    assert files(tiles) != before
    status, content = asked(server, root + "zip", body=save, Origin=ours)
    assert status == 200 and zipfile.ZipFile(io.BytesIO(content)).testzip() is None


def started(folder, *arguments):
    """Starts the command; returns its process and the address of its page."""
    command = [sys.executable, "-m", "elitelanes_jax", "tiles", "edit", *arguments]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # under nohup it is ignored
    process = subprocess.Popen(command, cwd=folder, **pipes)
    signal.signal(signal.SIGINT, before)
    return process, re.search(r"http://\S+", process.stdout.readline())[0]


def post(url, action, values):
    """Sends a request of the page; returns the answer."""
    port, token = re.search(r":(\d+)/(.+)/", url).groups()
    connection = http.client.HTTPConnection("127.0.0.1", int(port), timeout=20)
    connection.request("POST", f"/{token}/{action}", json.dumps(values), {"Content-Type": "application/json"})
    answer = connection.getresponse()
    assert answer.status == 200
    content = answer.read()
    connection.close()
    return content


def test_finish_ends_the_command(tiles):
    process, url = started(tiles.parent, "tiles")
    post(url, "finish", None)
    out, words = process.communicate(timeout=20)
    assert process.returncode == 0 and out.endswith("nothing was saved\n") and words == ""


def ask_to_save(url, values):
    with suppress(OSError, http.client.HTTPException):
        post(url, "save", values)


@pytest.mark.skipif(sys.platform == "win32", reason="no such signal")
@pytest.mark.parametrize("saves", [False, True])
def test_an_interruption_ends_the_command_in_one_line(tiles, saves):
    before = files(tiles)
    values = HandWork(tiles, [], []).state()["tiles"]
    process, url = started(tiles.parent, "tiles")
    try:
        if saves:
            # The signal comes while the set is written. The process may end before it has answered.
            Thread(target=ask_to_save, args=(url, values)).start()
            while not (tiles.parent / "tiles.before").exists():
                assert process.poll() is None
        process.send_signal(signal.SIGINT)
        words = process.communicate(timeout=20)[1]
    finally:
        process.kill()
        process.stdout.close()
        process.stderr.close()
        process.wait()
    result = "tiles is as it was saved last" if saves else "nothing was saved"
    assert (process.returncode, words) == (130, f"elitelanes: interrupted; {result}\n")
    assert {folder.name for folder in tiles.parent.iterdir()} == {"tiles"} | ({"tiles.before"} if saves else set())
    assert files(tiles.parent / "tiles.before" if saves else tiles) == before
    assert not inspect_tiles(tiles)[1]


@IN_BROWSER
def test_corners_masks_and_undo_in_a_browser(tmp_path):
    photographed.draw_photographs(tmp_path)
    process, url = started(tmp_path, "mine", "--photos", "floor.jpg", "--size", "3", "3")
    try:
        ran = subprocess.run(
            ["node", HERE / "hands.mjs", url, "390", tmp_path / "set.zip"],
            capture_output=True,
            text=True,
            check=False,
            timeout=240,
        )
        assert ran.returncode == 0, ran.stderr
        out = process.communicate(timeout=20)[0]
    finally:
        process.kill()
    with zipfile.ZipFile(tmp_path / "set.zip") as archive:
        archive.extractall(tmp_path / "unpacked")
    seen = json.loads(ran.stdout)
    assert (seen["console"], seen["axe"], seen["overflow"]) == ([], [], [])
    assert [url.startswith(origin) for origin in seen["requests"]] == [True]
    corners = [tuple(map(int, re.search(r"(\d+), (\d+)\.", label).groups())) for label in seen["corner"]]
    start, dragged, snapped, stepped, undone = (np.array(corner) for corner in corners)
    assert np.abs(dragged - start).min() >= 8
    assert np.abs(snapped - start).max() <= 1
    assert stepped.tolist() == (snapped + np.array([10, 0])).tolist() and undone.tolist() == snapped.tolist()
    assert seen["fits"].startswith("The corners fit")
    assert seen["cells"] == [
        "B2: straight",
        "B2: turn",
        "opens south, west on the photograph",
        "B2: straight",
    ]
    assert (seen["cut"], seen["tiles"], seen["slider"]) == ("Cut 9 tiles", 9, "130")
    # The slider changed the picture, undo brought it back; a stroke and a key did, and two undos.
    assert seen["looks"] == [0, 1, 0, 3, 4, 5, 3]
    assert seen["reaches"] == ["The road reaches no side, which is no tile, not a turn."]
    assert seen["warned"].startswith("There are changes that are not saved")
    assert seen["warnedAgain"] == seen["warned"]
    assert seen["rows"][:2] == ["Expected a whole number from 1 to 40, got 44444", "3"]
    assert seen["rows"][2].startswith("B2: ")
    assert seen["saved"] == "Saved 9 tiles in mine" and seen["problems"].endswith("No problems.")
    assert (seen["zip"], seen["notes"]) == ("mine.zip", [0, 1, 1])
    assert files(tmp_path / "unpacked" / "mine") == files(tmp_path / "mine")
    assert process.returncode == 0 and out.endswith("saved in mine; now: elitelanes tiles check mine\n")
    assert main(["tiles", "check", str(tmp_path / "mine")]) == 0
    turn = next(tile for tile in load_tiles(tmp_path / "mine").tiles if tile.name == "turn_1")
    assert not turn.road[60:68, 60:68].any()  # the stroke that erased


def test_a_page_that_is_closed_while_it_loads_prints_nothing(tiles, capfd):
    with HandServer(HandWork(tiles, [], [])) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        ended = Event()
        server.shutdown_request = lambda request: (HandServer.shutdown_request(server, request), ended.set())
        with socket.create_connection(server.server_address) as page:
            # A reset instead of an orderly end, as from a browser that reloads the page.
            page.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            page.sendall(b"GET /")
        assert ended.wait(60)
        server.shutdown()
    assert capfd.readouterr().err == ""
