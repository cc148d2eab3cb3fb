"""Training that holds: resumed, killed, told to stop, spoilt, and spread over processes."""

from __future__ import annotations

import hashlib
import itertools
import json
import os
import signal
import socket
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import pytest
import torch
from conftest import HANG
from helpers.training import TASK, TinyModel, TinyTask
from helpers.training import tiny_config as config
from safetensors import safe_open
from safetensors.torch import load_file, save_file

from warp_partdr.cli.main import app
from warp_partdr.errors import InputError
from warp_partdr.lab.training.checkpoints import list_checkpoints, load_checkpoint
from warp_partdr.lab.training.config import TASKS, Phase, make_config, packaged_configs, read_config
from warp_partdr.lab.training.loop import run_training
from warp_partdr.lab.training.running_mean import RunningMean


def newest(out: Path):
    return load_checkpoint(list_checkpoints(out / "checkpoints")[-1])


def lines(out: Path, name: str = "loss") -> list[dict]:
    found = [json.loads(line) for line in (out / "log.jsonl").read_text().splitlines()]
    return [{"step": line["step"], **line[name]} for line in found if name in line]


def flat(out: Path) -> dict[str, torch.Tensor]:
    """All numbers of the newest checkpoint that training computes or draws."""
    checkpoint = newest(out)
    tensors = {f"{file}/{name}": value for file, each in checkpoint.tensors.items() for name, value in each.items()}
    (state,) = checkpoint.ranks
    drawn = {name: state[name] for name in ("torch", "cuda") if state[name] is not None}
    return {**tensors, **drawn, **state["own"]["sums"], "generator": state["own"]["task"]["generator"]}


def same(first: dict[str, torch.Tensor], second: dict[str, torch.Tensor]) -> bool:
    return first.keys() == second.keys() and all(torch.equal(value, second[name]) for name, value in first.items())


def tell(monkeypatch, step: int, number: int) -> None:
    """Send this process a signal while it makes its batch of this number, counted from 1."""
    batch = TinyTask.batch

    def told(self, device):
        if self.made == step - 1:
            os.kill(os.getpid(), number)
        return batch(self, device)

    monkeypatch.setattr(TinyTask, "batch", told)


@pytest.mark.parametrize(("number", "optimizer"), [(signal.SIGTERM, "adamw"), (signal.SIGINT, "muon")])
def test_stopped_and_resumed_is_bit_for_bit_uninterrupted(tmp_path, monkeypatch, device, number, optimizer):
    numbers = {"accumulation": 2, "warm_up": 2, "optimizer": optimizer}
    whole = run_training(config(tmp_path / "whole", **numbers), device=device)
    assert (whole.step, whole.stopped) == (6, None)

    handler = signal.getsignal(number)
    with monkeypatch.context() as patch:
        tell(patch, 5, number)  # within step 3 of two batches each; the losses of three steps wait for the log
        part = run_training(config(tmp_path / "parts", **numbers), device=device)
    assert (part.step, part.stopped) == (3, number)
    assert signal.getsignal(number) == handler
    assert not (tmp_path / "parts/model.safetensors").exists()

    torch.rand(7)
    rest = run_training(config(tmp_path / "parts", **numbers), resume=True, device=device)
    assert (rest.step, rest.stopped, rest.report["resumed_at"]) == (6, None, 3)
    assert same(flat(tmp_path / "parts"), flat(tmp_path / "whole"))
    for name in ("loss", "validation"):
        assert lines(tmp_path / "parts", name) == lines(tmp_path / "whole", name)
    assert same(load_file(tmp_path / "parts/model.safetensors"), load_file(tmp_path / "whole/model.safetensors"))
    assert not same(load_file(tmp_path / "whole/model.safetensors"), newest(tmp_path / "whole").tensors["model"])


# Code that has a process kill itself: while it makes batch 8, or when checkpoint 3 is written, but not in its place.
IN_A_STEP = """
import os, signal
from helpers.training import TinyTask
batch = TinyTask.batch
def killed(self, device):
    if self.made == 7:
        os.kill(os.getpid(), signal.SIGKILL)
    return batch(self, device)
TinyTask.batch = killed
"""
IN_A_CHECKPOINT = """
import os, signal
from warp_partdr.lab.training import checkpoints
replace = os.replace
def killed(source, target):
    if target.name == "step-00000009":
        os.kill(os.getpid(), signal.SIGKILL)
    return replace(source, target)
os.replace = killed
"""


@pytest.mark.parametrize("first", [IN_A_STEP, IN_A_CHECKPOINT])
def test_a_killed_process_loses_the_steps_since_its_last_checkpoint_alone(tmp_path, first):
    numbers = {"steps": 12, "checkpoint_every": 3}
    command = [sys.executable, script(tmp_path, "killed", numbers, first)]
    done = subprocess.run(command, env=environment(), capture_output=True, text=True, check=False, timeout=HANG)
    assert done.returncode == -signal.SIGKILL, done.stderr
    assert newest(tmp_path / "killed").about["step"] == 6

    rest = run_training(config(tmp_path / "killed", **numbers), resume=True, device="cpu")
    run_training(config(tmp_path / "whole", **numbers), device="cpu")
    assert rest.report["resumed_at"] == 6
    assert same(flat(tmp_path / "killed"), flat(tmp_path / "whole"))
    assert lines(tmp_path / "killed") == lines(tmp_path / "whole")


def script(folder: Path, out: str, numbers: dict, first: str = "") -> Path:
    """A file that trains into a folder beside it, where TensorBoard is not installed; ``first`` is done before."""
    path = folder / f"{out}.py"
    path.write_text(
        f"""
import json, sys
sys.modules["tensorboard"] = None
from pathlib import Path
from helpers.training import tiny_config
from warp_partdr.lab.training.loop import run_training
{first}
run_training(tiny_config(Path({str(folder / out)!r}), **json.loads({json.dumps(numbers)!r})), device="cpu")
"""
    )
    return path


def environment() -> dict[str, str]:
    threads = str(torch.get_num_threads())  # sums on as many threads as here are the same to the last bit
    return {**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[1]), "OMP_NUM_THREADS": threads}


def train_in_two(tmp_path: Path, numbers: dict) -> list[str]:
    """Output of two processes that train together."""
    with socket.socket() as unused:
        unused.bind(("localhost", 0))
        port = unused.getsockname()[1]
    path = script(tmp_path, "two", numbers)
    processes = []
    for rank in ("0", "1"):  # as torchrun starts them
        place = {"RANK": rank, "LOCAL_RANK": rank, "WORLD_SIZE": "2", "LOCAL_WORLD_SIZE": "2"}
        place |= {"MASTER_ADDR": "localhost", "MASTER_PORT": str(port)}
        started = subprocess.Popen([sys.executable, path], env=environment() | place, stderr=subprocess.PIPE, text=True)
        processes.append(started)
    said = [process.communicate(timeout=HANG)[1] for process in processes]
    assert [process.returncode for process in processes] == [0, 0], said
    return said


def test_two_processes_step_as_one_with_the_joint_batch(tmp_path):
    numbers = {"steps": 3, "log_every": 3, "clip": float("inf"), "model": {"dropout": 0.0}, "data": {"joint": 16}}
    said = train_in_two(tmp_path, numbers)
    assert "no TensorBoard here" in said[0]
    assert "no TensorBoard here" not in said[1]
    run_training(config(tmp_path / "one", **numbers), device="cpu")
    one, two = newest(tmp_path / "one"), newest(tmp_path / "two")
    assert len(two.ranks) == 2
    for file in ("optimizer", "model"):
        for name, value in one.tensors[file].items():
            torch.testing.assert_close(two.tensors[file][name], value, rtol=1e-4, atol=1e-6, msg=f"{file}/{name}")
    (first,), (second,) = lines(tmp_path / "one"), lines(tmp_path / "two")
    assert second == pytest.approx(first, rel=1e-5)
    with pytest.raises(InputError, match="of 2 processes"):
        run_training(config(tmp_path / "two", **{**numbers, "steps": 5}), resume=True, device="cpu")


def test_two_processes_may_normalise_apart(tmp_path):
    numbers = {"steps": 2, "clip": float("inf"), "model": {"dropout": 0.0}, "data": {"joint": 16}}
    train_in_two(tmp_path, {**numbers, "joint_normalisation": False})
    run_training(config(tmp_path / "one", **numbers), device="cpu")
    one, two = (newest(tmp_path / name).tensors["model"] for name in ("one", "two"))
    assert not torch.allclose(two["1.running_mean"], one["1.running_mean"], rtol=1e-3)  # of half of the batch
    assert all(torch.isfinite(value).all() for value in two.values())


def test_begins_with_the_weights_of_another_run(tmp_path, device):
    run_training(config(tmp_path / "first"), device=device)
    first = load_file(tmp_path / "first/model.safetensors")
    again = {"initial": str(tmp_path / "first/model.safetensors"), "steps": 1, "learning_rate": 1e-9, "ema": 0.0}
    run_training(config(tmp_path / "second", **again), device=device)
    second = load_file(tmp_path / "second/model.safetensors")
    assert all(torch.allclose(second[name], first[name], atol=1e-6) for name in first if "weight" in name)
    run_training(config(tmp_path / "third", **{**again, "initial": None}), device=device)
    third = load_file(tmp_path / "third/model.safetensors")
    assert not torch.allclose(third["0.weight"], first["0.weight"], atol=1e-3)


def test_checkpoints_are_whole_and_few(tmp_path):
    half_written = tmp_path / "checkpoints/.step-00000004"
    half_written.mkdir(parents=True)
    (half_written / "model.safetensors").write_bytes(b"half")
    run_training(config(tmp_path, checkpoint_every=1, keep=2), device="cpu")
    assert sorted(path.name for path in (tmp_path / "checkpoints").iterdir()) == ["step-00000005", "step-00000006"]
    files = [path for path in (tmp_path / "checkpoints").rglob("*") if path.is_file()]
    assert {path.suffix for path in files} == {".safetensors", ".json"}


@pytest.fixture
def after_two(tmp_path):
    """The checkpoint of a run of two steps in ``tmp_path``."""
    run_training(config(tmp_path, steps=2), device="cpu")
    (place,) = list_checkpoints(tmp_path / "checkpoints")
    return place


def test_only_a_folder_without_a_run_is_begun_anew(tmp_path, capfd):
    assert run_training(config(tmp_path, steps=2), resume=True, device="cpu").report["resumed_at"] == 0
    assert "begins anew" in capfd.readouterr().err
    with pytest.raises(InputError, match="holds a run; expected --resume"):
        run_training(config(tmp_path, steps=2), device="cpu")


def of_another_network(place: Path) -> bytes:
    """The state of a checkpoint whose files are whole, but of another network."""
    save_file({"weight": torch.zeros(3)}, place / "model.safetensors")
    state = json.loads((place / "state.json").read_text())
    state["sha256"]["model"] = hashlib.sha256((place / "model.safetensors").read_bytes()).hexdigest()
    return json.dumps(state).encode()


@pytest.mark.parametrize(
    ("name", "harmed", "said"),
    [
        ("model.safetensors", lambda held, _: held[:-3], "model.safetensors: damaged"),
        ("optimizer.safetensors", lambda held, _: held[:-1] + bytes([held[-1] ^ 1]), "optimizer.safetensors: damaged"),
        ("state.json", lambda held, _: b'{"format": "another"}', "another format"),
        ("state.json", lambda held, _: b'{"format": ', "state.json: damaged"),
        ("state.json", lambda held, place: of_another_network(place), "expected a checkpoint of this network"),
        ("mean.safetensors", None, "No such file"),
    ],
)
def test_damaged_and_foreign_checkpoints_are_refused(tmp_path, after_two, name, harmed, said):
    if harmed:
        (after_two / name).write_bytes(harmed((after_two / name).read_bytes(), after_two))
    else:
        (after_two / name).unlink()
    with pytest.raises(InputError, match=rf"step-00000002.*{said}"):
        run_training(config(tmp_path, steps=4), resume=True, device="cpu")


@pytest.mark.parametrize("values", [{"batch_size": 9}, {"model": {"inputs": 5}}, {"weights": {"fit": 2.0}}])
def test_a_checkpoint_of_another_config_is_refused(tmp_path, after_two, values):
    (name,) = values
    with pytest.raises(InputError, match=f"{name} was"):
        run_training(config(tmp_path, steps=4, **values), resume=True, device="cpu")


def test_a_run_can_be_made_longer_and_its_rate_changed_and_says_so(tmp_path, after_two, capfd):
    assert run_training(config(tmp_path, steps=4, learning_rate=0.001), resume=True, device="cpu").step == 4
    said = capfd.readouterr().err
    assert "steps was 2, is 4" in said
    assert "learning_rate was 0.01, is 0.001" in said


@pytest.mark.parametrize("gradient_alone", [False, True])
def test_nan_stops_and_leaves_the_batch_that_led_to_it(tmp_path, monkeypatch, device, gradient_alone):
    made = {}

    def loss(self, model, batch):
        made[self.made] = batch.inputs.cpu()
        error = model(batch.inputs) - batch.wanted
        if self.made == 3:  # sqrt has an infinite slope at 0, and 0 times that is NaN
            error = (error * 0).sqrt() if gradient_alone else error / 0
        term = error.square().mean()
        return {"fit": term, "total": term}

    monkeypatch.setattr(TinyTask, "loss", loss)
    with pytest.raises(InputError, match="step 3: loss or gradient is NaN"):
        run_training(config(tmp_path, steps=30, checkpoint_every=2, validate_every=0), device=device)
    with safe_open(tmp_path / "nan-batch.safetensors", "pt") as file:
        assert file.metadata()["step"] == "3"
        assert torch.equal(file.get_tensor("batch.inputs"), made[3])
    assert newest(tmp_path).about["step"] == 2  # none with NaN in it
    assert all(value.isfinite().all() for value in newest(tmp_path).tensors["model"].values())


@pytest.mark.parametrize(
    "error", [torch.OutOfMemoryError("CUDA"), RuntimeError("Failed to allocate 9 bytes on device")]
)
def test_out_of_memory_says_which_setting_to_lower(tmp_path, monkeypatch, error):
    monkeypatch.setattr(TinyTask, "loss", Mock(side_effect=error))
    with pytest.raises(InputError, match="batch_size: 8: out of memory; expected a smaller one"):
        run_training(config(tmp_path), device="cpu")


def test_a_phase_freezes_leaves_out_and_has_its_own_rate(tmp_path, device):
    phases = [{"until": 0.5}, {"learning_rate": 0.002, "frozen": ["0."], "without": ["small"]}]
    values = {"phases": phases, "schedule": "constant", "log_every": 3, "checkpoint_every": 3, "weight_decay": 0.1}
    run_training(config(tmp_path, **values), device=device)
    before, after = (load_checkpoint(path).tensors["model"] for path in list_checkpoints(tmp_path / "checkpoints"))
    assert torch.equal(before["0.weight"], after["0.weight"])
    assert not torch.equal(before["3.weight"], after["3.weight"])
    first, second = lines(tmp_path)
    assert first.keys() == {"step", "fit", "small", "total"}
    assert second.keys() == {"step", "fit", "total"}
    assert [line["learning_rate"] for line in lines(tmp_path, "rate")] == [0.01, 0.002]
    with pytest.raises(InputError, match=r"phases\[0\].frozen: head; expected the beginning"):
        run_training(config(tmp_path / "wrong", phases=[{"frozen": ["head"]}]), device="cpu")


def test_bfloat16_and_float32_train_in_one_process(tmp_path, device):
    for precision in ("no", "bf16"):
        model = {"dropout": 0.0}  # on CUDA, what falls out hangs on the type
        values = {"precision": precision, "steps": 2, "log_every": 1, "model": model}
        run_training(config(tmp_path / precision, **values), device=device)
    one, two = (lines(tmp_path / precision)[0]["total"] for precision in ("no", "bf16"))
    assert one != two
    assert one == pytest.approx(two, rel=0.02)


def test_a_compiled_model_learns_the_same(tmp_path, device):
    values = {"steps": 3, "log_every": 1, "model": {"dropout": 0.0}}
    for compiled in (False, True):
        run_training(config(tmp_path / str(compiled), compile=compiled, **values), device=device)
    plain, compiled = (newest(tmp_path / str(compiled)).tensors["model"] for compiled in (False, True))
    assert plain.keys() == compiled.keys()
    assert all(torch.allclose(value.float(), compiled[name].float(), atol=1e-5) for name, value in plain.items())


def test_validation_and_log_change_nothing(tmp_path):
    run_training(config(tmp_path / "often", validate_every=1, log_every=1), device="cpu")
    run_training(config(tmp_path / "never", validate_every=0, log_every=7), device="cpu")
    assert same(newest(tmp_path / "often").tensors["model"], newest(tmp_path / "never").tensors["model"])


def test_the_learning_rate_follows_warm_up_phases_and_floor(tmp_path):
    numbers = config(tmp_path, warm_up=4, floor=0.1, phases=[{"until": 0.7}, {"learning_rate": 0.001}])
    first, second = numbers.phases
    assert [numbers.phase_at(share) for share in (0.0, 0.69, 0.7, 1.0)] == [first, first, second, second]
    assert numbers.learning_rate_at(1, 0.0) == pytest.approx(0.005)
    assert numbers.learning_rate_at(9, 0.5) == pytest.approx(0.0055)
    assert numbers.learning_rate_at(9, 1.0) == pytest.approx(0.0001)


def test_a_time_limit_ends_the_run_and_its_schedule(tmp_path, monkeypatch):
    """The clock is a fake one, on which a batch takes a second."""
    batch, now = TinyTask.batch, itertools.count(1)
    clock = SimpleNamespace(now=0, monotonic=lambda: clock.now)

    def timed(self, device):
        clock.now = next(now)
        return batch(self, device)

    monkeypatch.setattr(TinyTask, "batch", timed)
    monkeypatch.setattr("warp_partdr.lab.training.loop.time", clock)
    values = {"steps": 100_000, "minutes": 0.5, "log_every": 1}
    trained = run_training(config(tmp_path, validate_every=0, **values), device="cpu")
    assert trained.stopped is None
    assert trained.step == 30
    assert (tmp_path / "model.safetensors").exists()
    rates = [line["learning_rate"] for line in lines(tmp_path, "rate")]
    assert rates == sorted(rates, reverse=True)
    assert rates[-1] < 0.2 * rates[0]
    rest = run_training(config(tmp_path, **values), resume=True, device="cpu")
    assert rest.step == trained.step  # time is up


def test_the_running_mean_follows_weights_by_its_decay():
    model = torch.nn.Sequential(torch.nn.Linear(2, 1, bias=False), torch.nn.BatchNorm1d(1))
    mean = RunningMean(model, decay=0.5)
    start = model[0].weight.detach().clone()
    with torch.no_grad():
        model[0].weight += 1
        model[1].running_mean += 1
        model[1].num_batches_tracked += 3
    mean.update(model)  # decay 2/11
    torch.testing.assert_close(mean.module[0].weight, start + 9 / 11)
    mean.steps = 1000
    mean.update(model)
    torch.testing.assert_close(mean.module[0].weight, start + 1 - 1 / 11)
    torch.testing.assert_close(mean.module[1].running_mean, torch.tensor([1 - 1 / 11]))
    assert mean.module[1].num_batches_tracked == 3
    assert not mean.module.training


def test_the_command_trains_and_writes_its_files(tmp_path, capfd):
    path = tmp_path / "tiny.toml"
    path.write_text(f'task = "{TASK}"\nsteps = 2\nbatch_size = 8\n')
    options = ["--out", str(tmp_path / "out"), "--set", "data.noise=0.5", "--bits", "16", "--device", "cpu"]
    app(["train", str(path), *options], standalone_mode=False)
    said = capfd.readouterr()
    assert "2 steps" in said.out
    assert "skipped: picture7: damaged" in said.err
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert written >= {"model.safetensors", "report.json", "checkpoints", "log.jsonl", "pictures"}
    assert load_file(tmp_path / "out/model.safetensors")["0.weight"].dtype == torch.float16
    report = json.loads((tmp_path / "out/report.json").read_text())
    assert report["config"]["data"]["noise"] == 0.5
    assert report["errors"]["error"] > 0
    assert report["samples_per_step"] == 8
    with pytest.raises(InputError, match="CUDA_VISIBLE_DEVICES"):
        app(["train", str(path), "--device", "cuda:1"], standalone_mode=False)


def test_packaged_configs_are_read():
    tasks = {name: read_config(name).task for name in packaged_configs()}
    assert tasks == {name: name for name in TASKS} | {"ellipbodynet-shaded": "ellipbodynet", "parts-smoke": "parts"}


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("speed=1", "speed: unknown; expected one of task, steps"),
        ("batch_size=1.5", "batch_size: 1.5; expected a whole number"),
        ("batch_size=true", "batch_size: True; expected a whole number"),
        ("batch_size=0", "batch_size: 0; expected 1 or more"),
        ("learning_rate=fast", "learning_rate: 'fast'; expected a number"),
        ("learning_rate=nan", "learning_rate: nan; expected a positive number"),
        ("precision=fp8", "precision: 'fp8'; expected 'no' or 'bf16'"),
        ("betas=[0.9]", r"betas: \[0.9\]; expected \[a number, a number\]"),
        ("betas=[0.9, 1.0]", r"betas\[1\]: 1.0; expected a number from 0"),
        ("model.width=3", "model.width: unknown; expected one of inputs, dropout"),
        ("data.noise=loud", "data.noise: 'loud'; expected a number"),
        ("model=3", "model: 3; expected a table"),
        ("steps.x=3", "steps is no table"),
        ("weights.none=1.0", "weights.none: unknown; expected one of fit, small"),
        ("phases=[{until=0.5}]", r"phases: until \[0.5\]; expected rising shares"),
        ("phases=[{without=['big']}]", r"phases\[0\].without: big; expected some of fit, small"),
        ("phases=[{end=1.0}]", r"phases\[0\].end: unknown; expected one of until"),
        ("task=gardening", "task: gardening; expected label-network, parts, ellipbodynet or module:Class"),
        ("task=nowhere:Task", "task: nowhere:Task: No module named"),
        ("noise", "--set: noise; expected key=value"),
    ],
)
def test_wrong_numbers_are_named(tmp_path, override, said):
    path = tmp_path / "tiny.toml"
    path.write_text(f'task = "{TASK}"\nsteps = 2\n')
    with pytest.raises(InputError, match=said):
        read_config(path, [override])


def test_config_is_read_as_written(tmp_path):
    path = tmp_path / "tiny.toml"
    path.write_text(f'task = "{TASK}"\nsteps = 2\n[weights]\nfit = 3.0\n[[phases]]\nfrozen = ["0."]\n')
    numbers = read_config(path, ["epochs=2", "out=somewhere/else", "model.inputs=3"])
    assert (numbers.steps, numbers.epochs, numbers.out) == (None, 2.0, Path("somewhere/else"))
    assert numbers.weights == {"fit": 3.0, "small": 1e-3}
    assert numbers.phases == (Phase(frozen=("0.",)),)
    assert numbers.model == TinyModel(inputs=3)
    assert make_config(numbers.to_json()) == numbers


def test_files_that_are_no_configs_are_refused(tmp_path):
    path = tmp_path / "bad.toml"
    for content, said in (("steps = 2", "task: missing"), ("steps =", "expected TOML")):
        path.write_text(content)
        with pytest.raises(InputError, match=said):
            read_config(path)
    with pytest.raises(InputError, match=r"garden.*expected a .toml file, or one of .*label-network"):
        read_config("garden")


def test_epochs_count_samples(tmp_path, monkeypatch):
    assert run_training(config(tmp_path, epochs=0.5, steps=None), device="cpu").step == 4  # of 64 samples, 8 a step
    monkeypatch.setattr(TinyTask, "epoch", None)
    with pytest.raises(InputError, match=r"epochs: 0\.5; expected steps"):
        run_training(config(tmp_path / "endless", epochs=0.5, steps=None), device="cpu")
