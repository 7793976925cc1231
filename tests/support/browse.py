import rerun as rr

server = rr.server.Server(datasets={"runs": "runs/0001"})
runs = server.client().get_dataset("runs")
table = runs.segment_table().to_pandas().set_index("rerun_segment_id")
value = lambda name: table[f"property:{name}"].str[0]
print(value("result:measured_sway_m_per_s").groupby(value("run:controller")).agg(["mean", "std", "count"]))
rows = runs.filter_contents(["/tracking/sway"]).reader(index="tick").to_pandas()
sway = rows["/tracking/sway:Scalars:scalars"]  # measured, reference, true
error = (sway.str[0] - sway.str[1]).abs()
print(error.groupby(rows["rerun_segment_id"]).max().to_json())
