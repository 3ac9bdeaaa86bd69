import torch
from builders import make_gruvae, normal

from detden_lite.defense.denoiser import Denoiser


def denoise(denoiser, obs, episodes):
    """Sequences ``[N, steps, obs_dim]``, step by step."""
    denoiser.reset(episodes)
    return torch.stack([denoiser.step(o) for o in obs.unbind(1)], 1)


def test_without_sampling_it_is_the_whole_sequence_pass():
    model, obs = make_gruvae(residual=True), normal(3, 10, 11)
    assert torch.allclose(denoise(Denoiser(model, sample=False), obs, range(3)), model(obs).output, atol=1e-5)


def test_the_latent_is_sampled_with_the_episodes_own_numbers():
    obs = normal(3, 5, 11)
    together = denoise(Denoiser(make_gruvae()), obs, [4, 5, 6])
    assert torch.allclose(denoise(Denoiser(make_gruvae()), obs[1:2], [5]), together[1:2], atol=1e-6)
    assert not torch.allclose(denoise(Denoiser(make_gruvae()), obs, [7, 8, 9]), together)
    assert not torch.allclose(denoise(Denoiser(make_gruvae(), sample=False), obs, [4, 5, 6]), together)


def test_memory_begins_anew_at_reset():
    denoiser, obs = Denoiser(make_gruvae()), normal(2, 5, 11)
    assert torch.equal(denoise(denoiser, obs, range(2)), denoise(denoiser, obs, range(2)))
