"""Several processes that train one network: each takes its share of every batch."""

import os
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count

import torch
import torch.distributed as dist
from torch import nn
from torch.nn.parallel import DistributedDataParallel
from torch.utils.data import Sampler


class Share(Sampler[int]):
    """Numbers of the samples of one process, endless: its part of each batch from `step` on."""

    def __init__(self, step: int, batch: int, rank: int, size: int) -> None:
        """Take part `rank` of `size` of every batch of `batch` samples."""
        self._step, self._batch, self._rank, self._size = step, batch, rank, size

    def __iter__(self) -> Iterator[int]:
        """Count through the batches."""
        part = self._batch // self._size
        for step in count(self._step):
            first = step * self._batch + self._rank * part
            yield from range(first, first + part)


@dataclass(frozen=True, slots=True, kw_only=True)
class Team:
    """The processes that torchrun started, or this one alone."""

    rank: int
    size: int
    device: torch.device

    @classmethod
    def join(cls, batch_pairs: int) -> "Team":
        """Find the others by the variables that torchrun sets.

        Raises:
            SystemExit: the batch cannot be shared evenly.
        """
        rank, size = int(os.environ.get("RANK", 0)), int(os.environ.get("WORLD_SIZE", 1))
        if batch_pairs % size:
            raise SystemExit(f"a batch of {batch_pairs} pairs cannot be shared by {size} processes")
        device = torch.device("cpu")
        if torch.cuda.is_available():
            device = torch.device("cuda", int(os.environ.get("LOCAL_RANK", 0)))
        if size > 1:
            dist.init_process_group("nccl" if device.type == "cuda" else "gloo")
        return cls(rank=rank, size=size, device=device)

    def say(self, line: str) -> None:
        """Print, once for all."""
        if self.rank == 0:
            print(line, flush=True)

    def share(self, network: nn.Module) -> nn.Module:
        """Wrap a network so that its gradients are averaged over the team."""
        return DistributedDataParallel(network) if self.size > 1 else network

    def samples(self, step: int, batch: int) -> Share:
        """Numbers of this process's samples from `step` on."""
        return Share(step, batch, self.rank, self.size)

    def agree(self, progress: float) -> float:
        """Progress as the first process sees it, so that all stop at the same step."""
        if self.size == 1:
            return progress
        told = torch.tensor([progress], dtype=torch.float64, device=self.device)
        dist.broadcast(told, src=0)
        return float(told.item())

    def leave(self) -> None:
        """Say goodbye to the others."""
        if self.size > 1:
            dist.barrier()  # gloo aborts one that leaves while another still speaks
            dist.destroy_process_group()
