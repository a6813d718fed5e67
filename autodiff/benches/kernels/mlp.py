"""The network of mlp.rs in PyTorch: best mean CPU milliseconds of 6 calls, forward and backward.

    python mlp.py [threads=1]
"""
import sys, time, torch
torch.set_num_threads(int(sys.argv[1]) if len(sys.argv) > 1 else 1)
torch.manual_seed(0)
sizes = [3, 128, 128, 128, 128, 3]
layers = []
for k, (i, o) in enumerate(zip(sizes, sizes[1:])):
    layers += [torch.nn.Linear(i, o)] + ([torch.nn.ReLU()] if k < 4 else [])
net = torch.nn.Sequential(*layers)
x, target = torch.rand(16384, 3) * 2 - 1, torch.rand(16384, 3) * 2 - 1
def step():
    net.zero_grad()
    (net(x) - target).square().sum().backward()
step()
best = 1e9
for _ in range(5):
    start = time.process_time()
    for _ in range(6): step()
    best = min(best, (time.process_time() - start) / 6)
print(f'torch {torch.__version__} mlp grad {best * 1e3:.2f}')
