"""Images of your own frames: find order and sign of the channels, choose prior and hyperparameter."""

import numpy as np

import dermis

skin = dermis.Skin("healing-square")
model = skin.model(elements=1500)
twin = dermis.Twin(skin, seed=2)
baseline = np.stack([twin.step().values for _ in range(16)])
twin.press(x_mm=0, y_mm=10)
frames = np.stack([twin.step().values for _ in range(10)])
order = dermis.find_order(model, -baseline)
print(f"correlation {order.correlation:.4f}; {order.verdict}")
images = model.image(order.to_skin(-baseline), order.to_skin(-frames), prior="laplace", hyperparameter="l-curve")
print("images", images.shape, images.dtype, "largest", float(np.nanmax(np.abs(images))))
