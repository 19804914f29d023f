"""Long runs and other machines: no waiting for the device, compiled rows."""

import warnings

import oracles
import pyro
import pytest
import torch
from pyro.infer.smcfilter import SMCFailed
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode

from invdyn.inference import Bootstrap, Controlled, ParticleFilter
from invdyn.inference.filters import compiled as compiled_module
from invdyn.inference.variational.affine import Corrected
from invdyn.inference.variational.vsmc import GRADIENTS, VSMC_ELBO
from invdyn.models import ArmModel, Keypoints, Link, Observation, planar_body

STEPS = 12


def arm_of(rows):
    """A two-joint arm of so many rows."""
    links = [Link("upper", "shoulder", "elbow", 0.4, 1.0), Link("fore", "elbow", "wrist", 0.3, 0.6)]
    body = planar_body("arm", links, gravity=(0.0, -9.81))
    return ArmModel(body, 0.02 * torch.arange(rows), Observation(Keypoints([0, 1]))).to(torch.float32)


@pytest.fixture(scope="module")
def arm():
    """With gaps among its keypoints, one row of them wholly missing."""
    model = arm_of(STEPS)
    torch.manual_seed(0)
    y = model.simulate()[1]
    y[3] = torch.nan
    y[5, :2] = torch.nan
    return model, y


@pytest.fixture(scope="module")
def chain():
    chain = oracles.random_chain(seed=5, noise=6.0)
    return chain.model(STEPS), torch.as_tensor(chain.simulate(STEPS, seed=5)[1])


def the_guide(name, model, y):
    return {"bootstrap": Bootstrap, "controlled": lambda m: Controlled(m, y.double())}[name](model)


# -- no waiting --------------------------------------------------------------------------------
class Operations(TorchDispatchMode):
    """Counts operations whose result's size or check the host must see, wherever they are called."""

    NAMES = ("_local_scalar_dense", "nonzero", "masked_select", "_unique2", "equal", "normal")

    def __init__(self):
        super().__init__()
        self.count = 0

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        masked = function.overloadpacket.__name__ == "index" and any(
            index is not None and index.dtype == torch.bool for index in args[1]
        )
        self.count += masked or function.overloadpacket.__name__ in self.NAMES
        return function(*args, **(kwargs or {}))


class Values(TorchFunctionMode):
    """Counts Python's own questions for a tensor's value; not all of them are operations."""

    NAMES = ("item", "tolist", "__bool__", "__int__", "__float__", "__index__", "is_nonzero", "numpy", "cpu")

    def __init__(self):
        super().__init__()
        self.count = 0

    def __torch_function__(self, function, types, args=(), kwargs=None):
        self.count += getattr(function, "__name__", "") in self.NAMES
        return function(*args, **(kwargs or {}))


def waits(call):
    """How often ``call`` would make the host wait until an accelerator has come that far."""
    with Operations() as operations, Values() as values:
        call()
    return operations.count + values.count


def test_the_counter_sees_what_would_wait():
    x = torch.ones(3)
    for call in (
        lambda: x.sum().item(),
        lambda: bool(x.any()),
        lambda: float(x[0]),
        lambda: x[x > 0],
        lambda: torch.normal(x, x),
    ):
        assert waits(call) > 0
    assert waits(lambda: torch.where(x > 0, x, 0.0).sum()) == 0


@pytest.mark.parametrize("guide", ["bootstrap", "controlled"])
def test_the_time_loop_of_a_filter_waits_for_nothing(arm, guide):
    counts = {}
    for rows in (8, 12):
        model, y = arm_of(rows), arm[1][:rows]
        particle_filter = ParticleFilter(model, the_guide(guide, model, y), 20, num_filters=3)
        particle_filter.run(y)  # a model is checked once
        counts[rows] = waits(lambda run=particle_filter.run, y=y: run(y, synchronous=False))
    # a few times before the loop and once after, however many rows
    assert counts[8] == counts[12] < 10
    assert waits(lambda: particle_filter.run(y, synchronous=True)) > counts[12] + STEPS - 1


@pytest.mark.quick("affine-*")
@pytest.mark.parametrize("gradient", GRADIENTS)
@pytest.mark.parametrize("guide", ["affine", "corrected"])
def test_the_time_loop_of_the_bound_waits_for_nothing(arm, gradient, guide):
    scheme = "multinomial" if gradient == "score" else "systematic"
    counts = []
    for rows in (8, 12):
        pyro.clear_param_store()
        model, y = arm_of(rows), arm[1][:rows]
        own = Bootstrap(model) if guide == "affine" else Corrected(model, y.double())
        loss = VSMC_ELBO(8, 3, gradient=gradient, resampling=scheme, synchronous=False)
        loss.loss(model, own, y)  # a model is checked once
        evaluate = loss.differentiable_loss
        counts.append(waits(lambda call=evaluate, model=model, own=own, y=y: call(model.sequence, own, y)))
    assert counts[0] == counts[1]


@pytest.mark.parametrize("scheme", ["systematic", "multinomial"])
def test_waiting_for_nothing_gives_the_same_filter(chain, scheme):
    model, y = chain
    results = []
    for synchronous in (True, False):
        torch.manual_seed(3)
        # every row resamples, so that both ways draw the same random numbers
        particle_filter = ParticleFilter(model, Bootstrap(model), 30, num_filters=4, ess_threshold=1, resampling=scheme)
        results.append(particle_filter.run(y, synchronous=synchronous))
    assert torch.equal(results[0].states, results[1].states)
    assert torch.equal(results[0].log_evidence, results[1].log_evidence)
    assert torch.equal(results[0].ancestors, results[1].ancestors)


def test_a_dead_filter_is_found_at_the_end_with_its_row(chain):
    model, y = chain
    y = y.clone()
    y[5] = 1e200
    with pytest.raises(SMCFailed, match=r"2 filter.*row 5"), pyro.validation_enabled(False):
        ParticleFilter(model, Bootstrap(model), 10, num_filters=2).run(y, synchronous=False)


# -- compiled --------------------------------------------------------------------------------------
def test_without_a_compiler_it_runs_as_it_is_after_one_warning(arm, monkeypatch):
    model, y = arm

    def no_compiler(*args, **kwargs):
        raise RuntimeError("no C++ compiler\nand a long story")

    monkeypatch.setattr(compiled_module, "compile_record", no_compiler)
    results = []
    for compiled in (False, True):
        torch.manual_seed(2)
        particle_filter = ParticleFilter(model, Bootstrap(model), 20, num_filters=2, compiled=compiled)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            results.append(particle_filter.run(y))
            results.append(particle_filter.run(y))
        assert [str(w.message) for w in caught] == ["the filter runs uncompiled: no C++ compiler"] * compiled
    assert torch.equal(results[0].states, results[2].states)
    assert torch.equal(results[1].log_evidence, results[3].log_evidence)


def test_a_guide_that_cannot_be_traced_runs_as_it_is(chain):
    class Asks(Bootstrap):
        def propose(self, t, particles):
            return super().propose(int(t), particles)

    model, y = chain
    with pytest.warns(RuntimeWarning, match="uncompiled"):
        result = ParticleFilter(model, Asks(model), 20, num_filters=2, compiled=True).run(y)
    assert torch.isfinite(result.log_evidence).all()


@pytest.mark.quick("bootstrap")
@pytest.mark.parametrize("guide", ["bootstrap", "controlled"])
def test_the_recorded_row_is_the_row(arm, guide, monkeypatch):
    """What the compiler is given: one record for all rows with gaps, one for those without; here not compiled.

    In double precision: the record sums in another order, and what that changes grows from row to row.
    """
    model, y = arm[0].to(torch.float64), arm[1].double()
    assert arm[0].dtype == torch.float32  # the others' is as it was
    compile_ = []
    monkeypatch.setattr(compiled_module, "compile_record", lambda graph, example: compile_.append(example) or graph)
    results = []
    for compiled in (False, True):
        torch.manual_seed(2)
        particle_filter = ParticleFilter(model, the_guide(guide, model, y), 20, num_filters=2, compiled=compiled)
        results.append(particle_filter.run(y))
        particle_filter.run(y)
    assert len(compile_) == 2
    torch.testing.assert_close(results[0].states, results[1].states)
    torch.testing.assert_close(results[0].log_evidence, results[1].log_evidence)


@pytest.mark.quick("False")
@pytest.mark.parametrize("seen", [False, True])
def test_nothing_of_an_arms_row_is_put_together_but_what_it_leaves(arm, seen, monkeypatch):
    """Column by column: of all that the model stacks, the new states alone remain, and no product with a matrix."""
    model, y = arm
    records = []
    monkeypatch.setattr(compiled_module, "compile_record", lambda graph, example: records.append(graph) or graph)
    whole = y.nan_to_num() if not seen else y
    guide = the_guide("controlled", model, whole)
    ParticleFilter(model, guide, 20, num_filters=2, compiled=True).run(whole)
    for record in records:
        record.graph.eliminate_dead_code()
        large = [
            node.target
            for node in record.graph.nodes
            if isinstance(found := node.meta.get("val"), torch.Tensor) and found.numel() >= 2 * 20 * 4
        ]
        names = [target.overloadpacket.__name__ for target in large if hasattr(target, "overloadpacket")]
        assert names.count("stack") == 2  # x and where the model takes it
        assert not {"bmm", "mm", "cat"} & set(names)


@pytest.mark.slow
@pytest.mark.parametrize("guide", ["bootstrap", "controlled"])
def test_compiled_rows_are_the_rows_and_are_compiled_once(arm, guide, monkeypatch):
    model, y = arm
    results, count = [], []
    inductor = compiled_module.compile_record
    monkeypatch.setattr(compiled_module, "compile_record", lambda *a: count.append(1) or inductor(*a))
    for compiled in (False, True):
        torch.manual_seed(2)
        particle_filter = ParticleFilter(model, the_guide(guide, model, y), 500, num_filters=2, compiled=compiled)
        results.append(particle_filter.run(y))
    torch.testing.assert_close(results[0].log_evidence, results[1].log_evidence, atol=1e-3, rtol=0)
    torch.testing.assert_close(results[0].states[:3], results[1].states[:3], atol=1e-4, rtol=1e-4)
    particle_filter.run(y)
    assert len(count) == 2  # one for rows with gaps, one for those without
