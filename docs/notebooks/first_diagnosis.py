# %% [markdown]
# # Your first diagnosis
#
# `board51 demo` leaves a campaign: recordings of an emulated rig that differs a little from the paper's model. We
# identify that model, see where it is wrong, ask for the physical cause, and measure what the extended model improves.
#
# Run it cell by cell (Jupyter, VS Code, Spyder) beside `demo-out`, or as it is: `python first_diagnosis.py CAMPAIGN`.
# All quantities are in SI units; x is the height of the ball above the bottom stop.

# %%
import sys
from pathlib import Path

from twin import Campaign, diagnose, identify, predict, validate

words = [] if "ipykernel" in sys.modules else sys.argv[1:]  # those of a notebook are Jupyter's own
place = Path(words[0]) if words else max(Path("demo-out").glob("campaign-*"))
campaign = Campaign.load(place)
for recording in campaign.recordings:
    print(f"{recording.file:<28} {recording.kind:<16} {recording.use}")

# %% [markdown]
# ## 1 The paper's model
#
# Four parameters: K_A and T_A of the amplifier (1), K_c and b of the ball (6). Only recordings with `use = "fit"`
# count.

# %%
identified = identify(campaign)
print(identified.table())

# %% [markdown]
# ## 2 Is it good enough?
#
# `validate` judges by the recordings that were kept out. `rmse_m` is the error of the predicted position, `floor_m`
# what sensor noise alone would leave.

# %%
judged = validate(campaign, identified.model)
print(judged.answer)
for horizon_s, rmse_m, floor_m in zip(judged.horizon_s, judged.rmse_m, judged.floor_m, strict=True):
    print(f"{1e3 * horizon_s:5.0f} ms ahead: {1e6 * rmse_m:7.1f} um, noise floor {1e6 * floor_m:7.1f} um")

# %% [markdown]
# ## 3 What is the cause?
#
# `quick=True` takes less than a minute, and its confidence is not calibrated. Leave it out for the final answer.

# %%
found = diagnose(campaign, quick=True)
print(found.summary())
found.save("diagnosis")  # report.html, diagnosis.json, extended_model.json

# %% [markdown]
# ## 4 How much better is the extended model?

# %%
flight = next(one for one in campaign.recordings if one.use == "judge" and one.kind == "closed-loop")
for name, model in (("paper", identified.model), ("extended", found.extended)):
    ahead = predict(model, campaign.path_of(flight), campaign=campaign, horizon_samples=10)
    assert ahead.rmse_m is not None
    print(f"{name:<9} {1e6 * ahead.rmse_m:7.1f} um rms, {len(ahead.x_hat_m)} predictions of {ahead.recording}")

# %% [markdown]
# The figures are matplotlib's: change them as you like.

# %%
for title, figure in found.figures().items():
    figure.savefig(Path("diagnosis") / f"{title.replace(' ', '_').replace('/', '_')}.png", dpi=120)
print(*sorted(found.figures()), sep="\n")
